"""Depth errors against patch size and noise on simulated planes.

`python -m benchmarks.depth_sweep -o FOLDER`.

Writes `patch_size.csv` and `noise.csv`, and plots of both as PNG where matplotlib is installed.
Shares refer to all lenses with a whole microimage, errors [px] to the resolved lenses.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import lfrender
from data_synth import SCENES, Camera, Capture, simulate

_BEYOND = (0.8, 0.9, 0.95, 1.0, 1.2, 1.5)
_STEPS = (0.02, 0.06, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.75)
# `s / D` of an object at infinity, about, with the camera that is simulated.
_INFINITY = 0.055
_NOISE_DB = (40, 35, 30, 26, 22, 18, 15, 12)
_FIELDS = ("resolved", "right", "wrong", "bias", "median", "p95", "confidence")


def _shot(ratio: float, size: tuple[int, int], pitch: float) -> Capture:
    camera = Camera.design(size=size, pitch=pitch, rotation=1.3)
    return simulate(SCENES["plane"](camera, ratio=ratio), camera, samples=16, seed=2)


def _judge(shot: Capture, depth: lfrender.DepthMap) -> dict[str, float]:
    truth = shot.truth.patch_size
    lattice = shot.truth.calibration.lattice
    centres, (width, height) = lattice.centres(), lattice.image_size
    whole = (
        (centres > lattice.pitch / 2) & (centres < np.array([width, height]) - lattice.pitch / 2)
    ).all(1)
    known = whole & np.isfinite(depth.patch_size)
    error = (depth.patch_size - truth)[known]
    clear = known & (np.abs(depth.patch_size) > 0.5)
    right = clear & (np.sign(depth.patch_size) == np.sign(truth))
    size = np.abs(error) if error.size else np.array([np.nan])
    return dict(
        zip(
            _FIELDS,
            (
                float(known.sum() / whole.sum()),
                float(right.sum() / whole.sum()),
                float((clear & ~right).sum() / whole.sum()),
                float(np.median(error)) if error.size else float("nan"),
                float(np.median(size)),
                float(np.percentile(size, 95)),
                float(np.median(depth.confidence[whole])),
            ),
            strict=True,
        )
    )


def sweep_patch_size(size: tuple[int, int], pitch: float) -> list[dict[str, float]]:
    """Planes with `s / D` from -0.75 to 0.75 and beyond, one row each."""
    # No object is at the places next to zero that lie beyond infinity.
    ratios = [
        r
        for r in sorted([-r for r in (*_STEPS, *_BEYOND)] + [*_STEPS, *_BEYOND])
        if not 0 < r < _INFINITY
    ]
    rows = []
    for ratio in ratios:
        shot = _shot(ratio, size, pitch)
        rows.append(
            {"s / D": ratio} | _judge(shot, lfrender.analyze(shot.flat, shot.truth.calibration))
        )
    return rows


def noisy(flat: NDArray[np.uint8], decibels: float, seed: int = 0) -> NDArray[np.uint8]:
    """`flat` with white noise `decibels` below white."""
    noise = np.random.default_rng(seed).normal(0, 255 * 10 ** (-decibels / 20), flat.shape)
    return np.clip(np.rint(flat + noise), 0, 255).astype(np.uint8)


def sweep_noise(size: tuple[int, int], pitch: float, ratio: float = -0.3) -> list[dict[str, float]]:
    """One plane under noise of 40 to 12 dB below white, one row each."""
    shot = _shot(ratio, size, pitch)
    calibration = shot.truth.calibration
    return [
        {"PSNR [dB]": float(db)} | _judge(shot, lfrender.analyze(noisy(shot.flat, db), calibration))
        for db in _NOISE_DB
    ]


def _write(path: Path, rows: list[dict[str, float]]) -> None:
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows({name: f"{value:.5g}" for name, value in row.items()} for row in rows)


def _plot(path: Path, rows: list[dict[str, float]]) -> None:
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise SystemExit(
            f"{path}: plots need matplotlib: pip install matplotlib ({error})"
        ) from error
    across = next(iter(rows[0]))
    x = [row[across] for row in rows]
    figure = Figure(figsize=(9, 7), layout="constrained")
    shares, errors = figure.subplots(2, sharex=True)
    for name in ("resolved", "right", "wrong", "confidence"):
        shares.plot(x, [row[name] for row in rows], marker=".", label=name)
    for name in ("median", "p95"):
        errors.semilogy(
            x, [row[name] for row in rows], marker=".", label=f"|error of s| {name} [px]"
        )
    errors.set_xlabel(across)
    for axes in (shares, errors):
        axes.grid(True)
        axes.legend()
    figure.savefig(path, dpi=100)


def main() -> None:
    """Run both sweeps and write them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write to")
    parser.add_argument(
        "--size", type=int, nargs=2, default=(420, 340), metavar=("W", "H"), help="flat [px]"
    )
    parser.add_argument("--pitch", type=float, default=23.2, help="[px]")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    size = (arguments.size[0], arguments.size[1])
    for name, rows in (
        ("patch_size", sweep_patch_size(size, arguments.pitch)),
        ("noise", sweep_noise(size, arguments.pitch)),
    ):
        _write(arguments.output / f"{name}.csv", rows)
        _plot(arguments.output / f"{name}.png", rows)
        for row in rows:
            print("  ".join(f"{key} {value:.4g}" for key, value in row.items()), flush=True)


if __name__ == "__main__":
    main()
