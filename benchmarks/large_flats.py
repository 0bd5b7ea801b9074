"""Time and memory of the commands on a flat of the size of Lumsdaine and Georgiev's, 24,862 x
21,818 RGB.

`python -m benchmarks.large_flats [--size WxH] [--pitch PX] [--folder FOLDER] [fixed] [calibrate]
[analyze] [sharp]`

The flat shows a textured relief of both modes through a hexagonal array; it is drawn band by band.
Each command runs in a process of its own, from TIFF to TIFF, with kernels that are compiled
already; memory is the peak of that process.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Calibration, Lattice
from lfcal.gain.gain_map import Vignetting

__all__ = ["main", "measure_command", "run", "write_flat"]

# Runs a command, and prints its processor seconds and its peak of memory as the last line on
# stderr. A process counts the memory of the one that starts it, so that this one is small.
_WATCH = """
import os, sys
child = os.spawnvp(os.P_NOWAIT, sys.argv[1], sys.argv[1:])
_, status, used = os.wait4(child, 0)
print(used.ru_utime + used.ru_stime, used.ru_maxrss, file=sys.stderr)
sys.exit(os.waitstatus_to_exitcode(status))
"""
_BAND = 512
_TURN = np.deg2rad(0.7)
# Output pixels of the paper's picture over pixels of its flat: 106 of 542 megapixels.
_PAPER = 106 / 542
# Patch sizes of the relief, as shares of the pitch, and how many pitches it takes from one to the
# next.
_RELIEF = (0.36, 0.48)
_PERIOD = 60.0


@njit(cache=True, nogil=True, parallel=True)
def _draw(top, origin, inverse, basis, pitch, radius, low, high, period, texture, out):
    height, width, channels = out.shape
    side = texture.shape[0]
    for row in prange(height):
        y = top + row
        for x in range(width):
            ox = x - origin[0]
            oy = y - origin[1]
            i0 = np.floor(ox * inverse[0, 0] + oy * inverse[1, 0])
            j0 = np.floor(ox * inverse[0, 1] + oy * inverse[1, 1])
            near = 1e30
            dx = 0.0
            dy = 0.0
            for corner in range(4):
                i = i0 + corner % 2
                j = j0 + corner // 2
                ex = ox - i * basis[0, 0] - j * basis[1, 0]
                ey = oy - i * basis[0, 1] - j * basis[1, 1]
                if ex * ex + ey * ey < near:
                    near = ex * ex + ey * ey
                    dx = ex
                    dy = ey
            # The relief is a staircase in both directions: one patch size within each step, no step
            # hides another.
            cx = x - dx
            cy = y - dy
            step = int(np.floor(cx / (period * pitch)) + np.floor(cy / (period * pitch)))
            s = pitch * (low + (high - low) * (step % 4) / 3) * (1 if step % 8 < 4 else -1)
            light = 1 - 0.2 * near / (radius * radius) if near < radius * radius else 0.1
            u = (cx - dx * pitch / s) / pitch * 24
            v = (cy - dy * pitch / s) / pitch * 24
            a = int(np.floor(u))
            b = int(np.floor(v))
            fu = u - a
            fv = v - b
            for k in range(channels):
                value = (1 - fv) * (
                    (1 - fu) * texture[b % side, a % side, k]
                    + fu * texture[b % side, (a + 1) % side, k]
                ) + fv * (
                    (1 - fu) * texture[(b + 1) % side, a % side, k]
                    + fu * texture[(b + 1) % side, (a + 1) % side, k]
                )
                out[row, x, k] = light * value


def _texture() -> NDArray[np.float32]:
    """(512, 512, 3) periodic texture of detail of all sizes."""
    rng = np.random.default_rng(4)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(512) * 512, np.fft.fftfreq(512) * 512))
    spectrum = np.fft.fft2(rng.standard_normal((512, 512, 3)), axes=(0, 1)) / (
        4 + frequency[..., None]
    )
    picture = np.fft.ifft2(spectrum, axes=(0, 1)).real
    return (118 + 45 * picture / picture.std()).clip(5, 250).astype(np.float32)


def write_flat(path: Path, size: tuple[int, int], pitch: float) -> Calibration:
    """Write a flat of `size` (width, height) as a TIFF, band by band; gives its true camera."""
    import tifffile

    width, height = size
    turn = np.array([[np.cos(_TURN), np.sin(_TURN)], [-np.sin(_TURN), np.cos(_TURN)]])
    basis = pitch * np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]]) @ turn
    origin = np.array([pitch * 0.3, pitch * 0.4])
    radius = 0.48 * pitch
    texture = _texture()

    def bands():
        for top in range(0, height, _BAND):
            out = np.empty((min(_BAND, height - top), width, 3), np.uint8)
            _draw(
                top,
                origin,
                np.linalg.inv(basis),
                basis,
                pitch,
                radius,
                *_RELIEF,
                _PERIOD,
                texture,
                out,
            )
            yield out

    tifffile.imwrite(
        path,
        bands(),
        shape=(height, width, 3),
        dtype=np.uint8,
        photometric="rgb",
        rowsperstrip=_BAND,
        metadata=None,
    )
    rings = np.linspace(0, 1, 33)
    return Calibration(
        Lattice(origin, basis, size, radius),
        Vignetting(1 - 0.2 * rings**2, radius / 32),
        source="truth",
    )


def measure_command(name: str, *command: str) -> dict[str, Any]:
    """Run a command, print its time and memory, and give its figures.

    Among them are its processor seconds, `"cpu"`, and its peak of memory, `"gib"`.
    """
    start = time.perf_counter()
    words = [sys.executable, "-m", *command, "--json", "--quiet"]
    done = subprocess.run([sys.executable, "-c", _WATCH, *words], capture_output=True, text=True)
    wall = time.perf_counter() - start
    if done.returncode:
        raise SystemExit(f"{name}: {' '.join(command)} failed: {done.stderr}")
    figures = json.loads(done.stdout)
    cpu, peak = map(float, done.stderr.splitlines()[-1].split())
    peak /= 2**30 if sys.platform == "darwin" else 2**20
    stages = ", ".join(f"{stage} {seconds:.2f}" for stage, seconds in figures["seconds"].items())
    print(
        f"{name:12s} {wall:8.2f} {cpu:8.2f} {peak:9.2f}  {stages}",
        flush=True,
    )
    return {**figures, "cpu": cpu, "gib": peak}


def run(
    folder: Path, size: tuple[int, int], pitch: float, steps: list[str]
) -> dict[str, dict[str, Any]]:
    """Measure the commands of some steps; their figures by step."""
    found = {}
    flat, camera, depth, picture = (
        folder / name for name in ("flat.tif", "camera.json", "depth.npz", "picture.tif")
    )
    calibration = write_flat(flat, size, pitch)
    calibration.save(camera)
    count = size[0] * size[1]
    print(
        f"{count / 1e6:.0f} Mpx, {3 * count / 2**30:.2f} GiB, pitch {pitch:g} px, "
        f"{len(calibration.lattice)} lenses"
    )
    # Kernels are compiled, or loaded, on a small flat first.
    small = folder / "small.tif"
    write_flat(small, (max(600, int(14 * pitch)), max(500, int(12 * pitch))), pitch).save(
        folder / "small.json"
    )
    scale = pitch * float(np.sqrt(_PAPER))
    fixed = ["--patch-size", f"{scale:.4f}"]
    for options in (fixed, ["--preset", "fast"]) if {"sharp", "analyze"} & set(steps) else (fixed,):
        command = [
            "lfrender.cli.main",
            "render",
            str(small),
            "-c",
            str(folder / "small.json"),
            "-o",
            str(picture),
        ]
        subprocess.run(
            [sys.executable, "-m", *command, "--tile", "256", "--quiet", *options], check=True
        )
    print(f"{'command':12s} {'wall s':>8s} {'CPU s':>8s} {'peak GiB':>9s}  stages", flush=True)
    drawn = ["-c", str(camera), "-o", str(picture)]
    if "fixed" in steps:
        figures = found["fixed"] = measure_command(
            "fixed patch", "lfrender.cli.main", "render", str(flat), *drawn, *fixed
        )
        print(
            f"{'':12s} picture of {np.prod(figures['size']) / 1e6:.0f} Mpx in "
            f"{figures.get('tiles', 1)} tiles",
            flush=True,
        )
    if "calibrate" in steps:
        found["calibrate"] = measure_command(
            "calibrate", "lfcal.cli.main", "calibrate", str(flat), "-o", str(folder / "found.json")
        )
    if "analyze" in steps:
        found["analyze"] = measure_command(
            "analyze",
            "lfrender.cli.main",
            "analyze",
            str(flat),
            "-c",
            str(camera),
            "-o",
            str(depth),
        )
    if "sharp" in steps:
        given = ["--depth", str(depth)] if depth.exists() else []
        found["sharp"] = measure_command(
            "sharp" if given else "whole chain",
            "lfrender.cli.main",
            "render",
            str(flat),
            *drawn,
            *given,
        )
    return found


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", default="24862x21818", help="width and height of the flat [px]")
    parser.add_argument("--pitch", type=float, default=75.0, help="[px]")
    parser.add_argument(
        "--folder", type=Path, help="where the flat is written; needs four times its bytes"
    )
    parser.add_argument("steps", nargs="*", default=["fixed", "calibrate", "analyze", "sharp"])
    given = parser.parse_args(arguments)
    width, _, height = given.size.partition("x")
    with tempfile.TemporaryDirectory(dir=given.folder) as folder:
        run(Path(folder), (int(width), int(height)), given.pitch, given.steps)


if __name__ == "__main__":
    main()
