"""Where the time of a command goes: `python -m benchmarks.command_time [FLAT ...] [--against TREE]
[--runs N]`.

For each flat, fresh processes import the modules of `lfrender render`, read the flat, and run each
stage twice. The second run is the time of the stage; the first run also loads its compiled kernels.
Whole commands follow. The table shows medians of processor and wall seconds, with one thread for
stages and all threads for commands.

`--against` names another checkout, or a revision of this one, which is checked out and compiled
first. Its processes and those of this tree run in turns, so that a busy machine slows both equally.
The last column is the time of this tree over that of the other. `--fresh` prints only the time of
compiling: the first command with an empty cache, in each tree.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

__all__ = ["main"]

_ROOT = Path(__file__).parents[1]
_CAPTURE = _ROOT.parent / "shared" / "captures" / "Fujita2.png"
# Run in a process of its own by `python -c`, with the flat and a folder to write into; prints one
# line of JSON.
_STAGES = """
import json, sys, time
from pathlib import Path

taken = {}

def measure(name, call):
    wall, processor = time.perf_counter(), time.process_time()
    result = call()
    taken[name] = time.process_time() - processor, time.perf_counter() - wall
    return result

def twice(name, call):
    measure("first " + name, call)
    return measure(name, call)

def load():
    import lfcal, lfrender, lfrender.cli.main
    steps = (lfrender.analyze, lfrender.render, lfrender.write_picture)
    return (*steps, lfcal.calibrate, lfcal.check_camera, lfcal.read_flat)

analyze, render, write, calibrate, check, read = measure("imports", load)
flat = measure("read", lambda: read(sys.argv[1]))
camera = twice("calibrate", lambda: calibrate(flat))
twice("check of the camera", lambda: check(camera, flat))
for preset in ("fast", "balanced"):
    depth = twice("analyze, " + preset, lambda: analyze(flat, camera, preset))
for detail in ("off", "natural"):
    picture = twice("render, " + detail, lambda: render(flat, camera, depth, detail=detail))
measure("write", lambda: write(Path(sys.argv[2]) / "picture.tif", picture))
firsts = [name for name in taken if name.startswith("first ")]
extra = [[a - b for a, b in zip(taken[name], taken[name[6:]])] for name in firsts]
taken["loading kernels"] = [sum(column) for column in zip(*extra)]
print(json.dumps({name: times for name, times in taken.items() if name not in firsts}))
"""

_Times = dict[str, tuple[float, float]]


def _environment(tree: Path, **more: str) -> dict[str, str]:
    environment = {**os.environ, "PYTHONPATH": str(tree), **more}
    # An installed package has its bytecode; without it, each start compiles all sources anew.
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    return environment


def _stages(tree: Path, flat: Path, folder: Path) -> _Times:
    """Processor and wall seconds of each stage, on one thread."""
    done = subprocess.run(
        [sys.executable, "-c", _STAGES, str(flat), str(folder)],
        cwd=tree,
        env=_environment(tree, NUMBA_NUM_THREADS="1"),
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        sys.exit(f"{tree}: {done.stderr[-2000:]}")
    found: _Times = json.loads(done.stdout.splitlines()[-1])
    return found


def _command(tree: Path, *arguments: str, **environment: str) -> tuple[float, float]:
    """Processor and wall seconds of one command."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", *arguments],
        cwd=tree,
        env=_environment(tree, **environment),
        capture_output=True,
        text=True,
        check=False,
    )
    wall = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(f"{tree}: {done.stderr[-2000:]}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall


def _commands(tree: Path, flat: Path, folder: Path) -> _Times:
    render = "lfrender.cli.main"
    camera = str(folder / "camera.json")
    out = str(folder / "picture.tif")
    known = (render, "render", str(flat), "-c", camera, "-o", out, "--quiet")
    return {
        "$ lfrender --help": _command(tree, render, "--help"),
        "$ lfcal calibrate": _command(
            tree, "lfcal.cli.main", "calibrate", str(flat), "-o", camera, "--quiet"
        ),
        "$ lfrender render": _command(tree, render, "render", str(flat), "-o", out, "--quiet"),
        "$ lfrender render -c": _command(tree, *known),
        "$ lfrender render -c --preset fast": _command(tree, *known, "--preset", "fast"),
    }


def _measure(trees: list[Path], flat: Path, folder: Path, runs: int) -> list[_Times]:
    """Medians of each tree, without the first run, which fills caches."""
    found: list[list[_Times]] = [[] for _ in trees]
    for run in range(runs + 1):
        for tree, rows in zip(trees, found, strict=True):
            times = {**_stages(tree, flat, folder), **_commands(tree, flat, folder)}
            if run > 0:
                rows.append(times)
    return [
        {
            name: (
                statistics.median(row[name][0] for row in rows),
                statistics.median(row[name][1] for row in rows),
            )
            for name in rows[0]
        }
        for rows in found
    ]


def _print(flat: Path, found: list[_Times]) -> None:
    print(
        f"{flat.name}: processor and wall "
        f"seconds{', of the other tree, and ratios' if len(found) > 1 else ''}"
    )
    for name in found[0]:
        text = "".join(f"{rows[name][0]:9.3f} {rows[name][1]:7.3f}" for rows in found)
        if len(found) > 1:
            processor, wall = (
                here / max(other, 1e-9)
                for here, other in zip(found[0][name], found[1][name], strict=True)
            )
            text += f"   {processor:6.2f} {wall:5.2f}"
        print(f"  {name:36}{text}", flush=True)


def _fresh(trees: list[Path], flat: Path, folder: Path) -> None:
    for tree in trees:
        with tempfile.TemporaryDirectory() as cache:
            out = str(folder / "picture.tif")
            times = _command(
                tree,
                "lfrender.cli.main",
                "render",
                str(flat),
                "-o",
                out,
                "--quiet",
                NUMBA_CACHE_DIR=cache,
            )
        print(
            f"{tree}: first lfrender render, nothing compiled: processor {times[0]:.1f} s, wall "
            f"{times[1]:.1f} s",
            flush=True,
        )


def _check_out(name: str, folder: Path) -> Path:
    """The folder with this name, or a new folder with this revision of the repository."""
    if Path(name).is_dir():
        return Path(name).resolve()
    tree = folder / "tree"
    archive = subprocess.run(
        ["git", "archive", name], cwd=_ROOT, capture_output=True, check=True
    ).stdout
    tree.mkdir()
    subprocess.run(["tar", "-x"], cwd=tree, input=archive, check=True)
    return tree


def main() -> None:
    """Print one table for each flat."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("flats", nargs="*", type=Path, default=[_CAPTURE])
    parser.add_argument("--against", help="another checkout, or a revision")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument(
        "--fresh", action="store_true", help="the first command with nothing compiled"
    )
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        trees = [_ROOT] if options.against is None else [_ROOT, _check_out(options.against, folder)]
        print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
        for flat in options.flats:
            if options.fresh:
                _fresh(trees, flat.resolve(), folder)
            else:
                _print(flat, _measure(trees, flat.resolve(), folder, options.runs))


if __name__ == "__main__":
    main()
