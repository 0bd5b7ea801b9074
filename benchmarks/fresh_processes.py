"""Whether commands end: `python -m benchmarks.fresh_processes [COUNT] [--empty N] [--busy]`.

Renders a small simulated flat in COUNT fresh processes, two at a time: in every form that flats
come in, with and without a camera file, and with the kernels compiled before; then in N pairs of
processes, each pair with one empty cache. `--busy` keeps all cores busy meanwhile. Printed are the
processes that did not end, ended later than 10 s after the median of their kind, or with a code or
a traceback. With `--interrupt` each gets a Ctrl-C at a random time of its run instead, and has 5 s
to end without a traceback; its output must be whole or absent, with no temporary file beside it.
Python itself answers an interrupt with a traceback until it reaches the code of the program: these
processes are counted apart.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np

import lfcal
import lfrender

from .first_run import make_flat

_ROOT = Path(__file__).parents[1]
_LATE = 10.0  # seconds after the median of a kind
_HUNG = 600.0  # seconds
_AT_ONCE = 5.0  # seconds
_BEFORE = "in Python's start"  # interrupted before the code of the program was reached


@dataclass(frozen=True)
class _Run:
    """A process: its flat, its form, its seconds, and its fault."""

    kind: str
    name: str
    seconds: float
    fault: str


def _write_flats(folder: Path) -> dict[str, Path]:
    """The flat in each form, by its name; the camera file beside them."""
    import tifffile
    from PIL import Image

    colour = make_flat()
    gray = np.rint(colour.mean(2)).astype(np.uint8)
    flats = {}
    for name, pixels in {
        "colour": colour,
        "gray": gray,
        "rgba": np.dstack([colour, np.full_like(gray, 255)]),
    }.items():
        for suffix in ("png", "ppm", "bmp", "jpg", "webp") if name != "rgba" else ("png",):
            flats[f"{name} {suffix}"] = folder / f"{name}.{suffix}"
            Image.fromarray(pixels).save(flats[f"{name} {suffix}"])
        whole: dict[str, Any] = {
            "8": pixels,
            "16": pixels.astype(np.uint16) * 257,
            "half": (pixels / 255).astype(np.float16),
            "float": (pixels / 255).astype(np.float32),
        }
        for depth, values in whole.items():
            flats[f"{name} tif {depth}"] = folder / f"{name}{depth}.tif"
            shown: dict[str, Any] = {"photometric": "minisblack" if name == "gray" else "rgb"}
            if name == "rgba":
                shown["extrasamples"] = ["unassalpha"]
            tifffile.imwrite(flats[f"{name} tif {depth}"], values, **shown)
    return flats


def _start(arguments: list[str], cache: Path, stdin: Any) -> subprocess.Popen[str]:
    """Start `lfrender` in a fresh process with its own cache of kernels."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(_ROOT)}
    return subprocess.Popen(
        [sys.executable, "-m", "lfrender", *arguments],
        env=environment,
        stdin=stdin,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        # A shell that starts benchmarks in the background ignores Ctrl-C for them.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


def _run(kind: str, name: str, arguments: list[str], flat: Path | None, cache: Path) -> _Run:
    """Run a process to its end."""
    start = time.perf_counter()
    with (flat or Path(os.devnull)).open("rb") as stdin:
        process = _start(arguments, cache, stdin)
    try:
        _, errors = process.communicate(timeout=_HUNG)
    except subprocess.TimeoutExpired:
        process.kill()
        return _Run(kind, name, _HUNG, "did not end")
    fault = ""
    if process.returncode:
        fault = f"ended with {process.returncode}: {errors.strip()[-300:]}"
    if "Traceback" in errors or "Exception ignored" in errors:
        fault = f"traceback: {errors.strip()[-300:]}"
    return _Run(kind, name, time.perf_counter() - start, fault)


def _interrupt(
    after: float, kind: str, name: str, arguments: list[str], flat: Path | None, cache: Path
) -> _Run:
    """Start a process, interrupt it `after` some seconds, and look at its output."""
    output = Path(arguments[arguments.index("-o") + 1])
    with (flat or Path(os.devnull)).open("rb") as stdin:
        process = _start(arguments, cache, stdin)
    with suppress(subprocess.TimeoutExpired):
        process.wait(after)
    start = time.perf_counter()
    process.send_signal(signal.SIGINT)
    try:
        _, errors = process.communicate(timeout=_HUNG / 10)
    except subprocess.TimeoutExpired:
        process.kill()
        return _Run(kind, name, _HUNG / 10, "did not end")
    seconds = time.perf_counter() - start
    code = process.returncode
    fault = ""
    if (
        "Traceback" in errors
        and str(_ROOT / "lfrender" / "__main__.py") not in errors
        and after < 1
    ):
        kind = _BEFORE
    elif "Traceback" in errors:
        fault = f"traceback: {errors.strip()[-300:]}"
    elif code not in (0, 130, -signal.SIGINT):
        fault = f"ended with {code}"
    if seconds > _AT_ONCE:
        fault = "later than 5 s after the interrupt"
    if output.exists():
        try:
            lfrender.DepthMap.load(output) if output.suffix == ".npz" else lfcal.read_flat(output)
        except lfcal.LightFieldError as error:
            fault = str(error)
    elif code == 0:
        fault = "ended with 0 and no output"
    if list(output.parent.glob(f".{output.stem}.*")):
        fault = "left a temporary file"
    told = f"{name}, interrupted after {after:.2f} s, code {code}"
    return _Run(kind, told, seconds, fault)


def _jobs(
    flats: dict[str, Path], camera: Path, folder: Path, cache: Path, count: int
) -> list[tuple[Any, ...]]:
    """Arguments of `_run`: each form with and without camera, the first forms also from stdin."""
    kinds: list[tuple[str, str, list[str], Path | None]] = []
    for name, flat in flats.items():
        kinds.append(("calibrated", name, ["render", str(flat)], None))
        kinds.append(("with camera", name, ["render", str(flat), "-c", str(camera)], None))
        kinds.append(("analyze", name, ["analyze", str(flat), "-c", str(camera)], None))
        if "tif" in name or "png" in name:
            kinds.append(("stdin", name, ["render", "-", "-c", str(camera)], flat))
    jobs = []
    for number, (kind, name, arguments, stdin) in enumerate(islice(cycle(kinds), count)):
        output = folder / f"{number}{'.npz' if kind == 'analyze' else '.tif'}"
        jobs.append(
            (
                kind,
                name,
                [*arguments, "-o", str(output), "--preset", "fast", "--quiet"],
                stdin,
                cache,
            )
        )
    return jobs


def main() -> None:
    """Print how the processes of each kind ended; exit with 1 if one ended wrongly."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=200)
    parser.add_argument("--empty", type=int, default=2)
    parser.add_argument("--busy", action="store_true")
    parser.add_argument("--interrupt", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        flats = _write_flats(folder)
        camera = folder / "camera.json"
        cache = folder / "cache"
        prepare = [
            sys.executable,
            "-m",
            "lfcal.cli.main",
            "calibrate",
            str(flats["colour png"]),
            "-o",
            str(camera),
        ]
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(_ROOT)}
        subprocess.run(prepare, env=environment, check=True, capture_output=True)
        loop = [sys.executable, "-c", "while True: pass"]
        busy = [subprocess.Popen(loop) for _ in range(os.cpu_count() or 1)] if options.busy else []
        try:
            jobs = _jobs(flats, camera, folder, cache, options.count)
            for number in range(options.empty):
                pair = _jobs(flats, camera, folder, folder / f"empty{number}", 2)
                jobs += [("empty cache", *job[1:]) for job in pair]
            with ThreadPoolExecutor(2) as pool:
                if options.interrupt:
                    # Kernels are loaded or compiled once; then that is how long a run takes.
                    longest = max(_run(*job).seconds for job in jobs[:4])
                    rng = random.Random(1)
                    times = [rng.uniform(0.0, 1.1 * longest) for _ in jobs]
                    runs = list(pool.map(lambda after, job: _interrupt(after, *job), times, jobs))
                else:
                    runs = list(pool.map(lambda job: _run(*job), jobs))
        finally:
            for process in busy:
                process.kill()
    faults = 0
    for kind in dict.fromkeys(run.kind for run in runs):
        same = [run for run in runs if run.kind == kind]
        median = statistics.median(run.seconds for run in same)
        latest = max(run.seconds for run in same)
        print(
            f"{kind:17} {len(same):4} processes, median {median:6.1f} s, latest {latest:6.1f} s",
            flush=True,
        )
        for run in same:
            fault = run.fault or (
                "late" if run.seconds > median + _LATE and kind != "empty cache" else ""
            )
            if fault:
                faults += 1
                print(f"  {run.name}: {run.seconds:.1f} s, {fault}")
    print(f"{len(runs) - faults} of {len(runs)} processes ended as they should")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
