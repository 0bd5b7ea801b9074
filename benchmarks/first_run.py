"""Times of the first minute after installation.

`python -m benchmarks.first_run [--runs N] [--install] [--only NAME ...]`.

Processes run as users start them, with a fresh cache: the start-up of commands and their imports,
commands with compiled kernels, the first demo, the first picture of a capture, and the first flat
of another kind. The table shows wall and processor seconds; compiling is the processor time of a
first run minus that of a second run. `--install` adds `pip install` into a fresh virtual
environment.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

_ROOT = Path(__file__).parents[1]
CAPTURES = _ROOT.parent / "shared" / "captures"
_LFRENDER = ("-m", "lfrender.cli.main")
_LFCAL = ("-m", "lfcal.cli.main")
KINDS: dict[str, dict[str, Any]] = {
    "gray": {"channels": 1},
    "16 bit": {"bits": 16},
    "gray, 16 bit": {"channels": 1, "bits": 16},
    "float": {"bits": 32},
    "gray, float": {"channels": 1, "bits": 32},
    "square": {"lattice": "square"},
    "three lens types": {"focus": (0.02, 0.04, 0.06)},
}


def _run(*arguments: str, cache: Path, python: str = sys.executable) -> tuple[float, float]:
    """Wall and processor seconds of a process of Python, with its own processes."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(_ROOT)}
    # An installed package has its bytecode; without it, each start compiles all sources anew.
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.perf_counter()
    done = subprocess.run([python, *arguments], env=environment, capture_output=True, text=True)
    wall = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(f"{' '.join(arguments)}: {done.stderr[-2000:]}")
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _print(name: str, figures: list[tuple[float, float]], note: str = "") -> None:
    walls, seconds = zip(*figures, strict=True)
    line = f"{name:44} wall {statistics.median(walls):7.2f} s (least {min(walls):6.2f})"
    print(
        f"{line}  processor {statistics.median(seconds):7.2f} s (least {min(seconds):6.2f}) {note}",
        flush=True,
    )


def _start_up(runs: int, cache: Path) -> None:
    for name, arguments in {
        "python -c 'import numpy'": ("-c", "import numpy"),
        "import lfrender": ("-c", "import lfrender"),
        "import lfcal": ("-c", "import lfcal"),
        "lfrender --help": (*_LFRENDER, "--help"),
        "lfrender render --help": (*_LFRENDER, "render", "--help"),
        "lfcal --help": (*_LFCAL, "--help"),
    }.items():
        _run(*arguments, cache=cache)
        _print(name, [_run(*arguments, cache=cache) for _ in range(runs)])
    traced = subprocess.run(
        [sys.executable, "-X", "importtime", "-c", "import lfrender, lfrender.cli.main"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(_ROOT)},
    )
    totals: dict[str, float] = {}
    for own, name in re.findall(r"import time:\s+(\d+) \|\s+\d+ \|\s+(\S+)", traced.stderr):
        package = name.partition(".")[0]
        totals[package] = totals.get(package, 0.0) + int(own) / 1000
    dearest = sorted(totals.items(), key=lambda item: -item[1])[:8]
    print(
        "  imports of the command line [ms]: "
        + ", ".join(f"{name} {ms:.0f}" for name, ms in dearest),
        flush=True,
    )


def _warm(runs: int, cache: Path, folder: Path) -> None:
    flat = str(CAPTURES / "Fujita2.png")
    camera = str(folder / "camera.json")
    _run(*_LFCAL, "calibrate", flat, "-o", camera, "--quiet", cache=cache)
    picture = ("-o", str(folder / "picture.tif"), "--quiet")
    for name, options in {
        "warm: render Fujita2 -c camera, fast": ("-c", camera, "--preset", "fast"),
        "warm: render Fujita2, calibrated, balanced": (),
    }.items():
        arguments = *_LFRENDER, "render", flat, *options, *picture
        _run(*arguments, cache=cache)
        _print(name, [_run(*arguments, cache=cache) for _ in range(runs)])


def _first_demo(cache: Path, folder: Path) -> None:
    arguments = *_LFRENDER, "demo", "-o", str(folder / "demo"), "--quiet"
    first = _run(*arguments, cache=cache)
    again = _run(*arguments, cache=cache)
    _print("first demo", [first], f" of it compiling {first[1] - again[1]:.1f} s")
    _print("second demo", [again])


def _first_picture(cache: Path, folder: Path) -> None:
    arguments = (
        *_LFRENDER,
        "render",
        str(CAPTURES / "Boys2.webp"),
        "-o",
        str(folder / "boys.tif"),
        "--quiet",
    )
    first = _run(*arguments, cache=cache)
    again = _run(*arguments, cache=cache)
    _print("first render of Boys2", [first], f" of it compiling {first[1] - again[1]:.1f} s")


def _other_kinds(cache: Path, folder: Path) -> None:
    import tifffile

    for kind, options in KINDS.items():
        flat = folder / f"{kind.replace(' ', '')}.tif"
        pixels = make_flat(**options)
        tifffile.imwrite(flat, pixels, photometric="rgb" if pixels.ndim == 3 else "minisblack")
        arguments = *_LFRENDER, "render", str(flat), "-o", str(folder / "kind.tif"), "--quiet"
        first = _run(*arguments, cache=cache)
        again = _run(*arguments, cache=cache)
        _print(f"first flat: {kind}", [first], f" of it compiling {first[1] - again[1]:.1f} s")


def _install(folder: Path) -> None:
    start = time.perf_counter()
    subprocess.run([sys.executable, "-m", "venv", str(folder / "venv")], check=True)
    subprocess.run([folder / "venv/bin/pip", "install", "--quiet", str(_ROOT)], check=True)
    print(
        f"{'pip install in a fresh environment':44} wall {time.perf_counter() - start:7.2f} s",
        flush=True,
    )


def make_flat(
    channels: int = 3,
    bits: int = 8,
    lattice: str = "hex",
    focus: Any = 0.04,
    size: tuple[int, int] = (700, 560),
) -> Any:
    """A simulated flat of the scene `house`."""
    return simulate_kind(lattice, focus, size, channels, bits).flat


def simulate_kind(
    lattice: str, focus: Any, size: tuple[int, int], channels: int = 3, bits: int = 8
) -> Any:
    from dataclasses import replace

    from data_synth import SCENES, Camera, simulate

    camera = Camera.design(size, pitch=20.3, lattice=lattice, rotation=1.3, focus=focus)
    capture = simulate(SCENES["house"](camera), camera, samples=8, seed=4)

    def convert(pixels: Any) -> Any:
        if channels == 1 and pixels.ndim == 3:
            pixels = np.rint(pixels.mean(2)).astype(np.uint8)
        whole = {
            8: pixels,
            16: pixels.astype(np.uint16) * 257,
            32: pixels.astype(np.float32) / np.float32(255),
        }
        return whole[bits]

    return replace(capture, flat=convert(capture.flat), white=convert(capture.white))


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--install", action="store_true")
    parser.add_argument("--only", nargs="*", default=["start", "demo", "picture", "kinds", "warm"])
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
        if options.install:
            _install(folder)
        if "start" in options.only:
            _start_up(options.runs, folder / "cache")
        if "demo" in options.only:
            _first_demo(folder / "cache", folder)
        if "kinds" in options.only:
            _other_kinds(folder / "cache", folder)
        if "picture" in options.only:
            _first_picture(folder / "picture-cache", folder)
        if "warm" in options.only:
            _warm(options.runs, folder / "cache", folder)


if __name__ == "__main__":
    main()
