"""Gain maps against the true light, and defects of sensors: `python -m benchmarks.gain_maps [SEED]`.

Three tables: random white images of sensors without a defect, random simulated scenes, and white
images with 300 hot pixels and 40 specks of dust. The error of a gain map is its value over the true
light of the pixel, where the map has one, less one. The scale is that of all pixels, on scenes
that of each lens, as scenes do not show the light of single lenses.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median

import lfcal
from data_synth import SCENES, Capture, simulate

from .random_scenes import draw
from .white_images import WhiteImage, random_cases, standard_cases

__all__ = ["GainErrors", "compare_gain", "count_found", "main"]

_WHITES = 20
_SCENES = 12
_SIZE = (1200, 900)
# Rays for each pixel of a scene, and of its true light.
_RAYS = 16
_TRUE_RAYS = 256
# Pixels with less true light, over the brightest, are in dark gaps.
_DARK = 0.05


@dataclass(frozen=True)
class GainErrors:
    """Relative errors of a gain map, over the pixels that have a gain."""

    rms: float
    most: float  # largest
    covered: float  # share of the pixels with light, gaps with stray light too, that have a gain


def compare_gain(camera: lfcal.Calibration, light: NDArray[Any], each_lens: bool) -> GainErrors:
    """Errors of the gain map of a camera over the true light (h, w), in any scale.

    `each_lens` if the scale of each lens is its own.
    """
    gain = camera.gain()
    shown = light > _DARK * light.max()
    used = shown & (gain > 0)
    ratio = gain[used] / light[used]
    scale: Any = np.median(ratio)
    if each_lens:
        rows, columns = np.nonzero(used)
        index = np.rint(camera.lattice.to_index(np.column_stack([columns, rows])))
        lens = np.unique(index, axis=0, return_inverse=True)[1].ravel()
        scale = median(ratio, lens, np.arange(lens.max() + 1))[lens]
    error = ratio / scale - 1
    return GainErrors(
        float(np.sqrt((error**2).mean())),
        float(np.abs(error).max()),
        float(used.sum() / shown.sum()),
    )


def count_found(camera: lfcal.Calibration, truth: WhiteImage, image: NDArray[Any]) -> list[int]:
    """Number of hot pixels and of specks that are among the defects, and of defects beside them."""
    bad = np.zeros(image.shape, bool)
    bad[tuple(camera.defects.pixels.T[::-1])] = True
    hot = image == image.max()
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    near = hot.copy()
    specks = 0
    for cx, cy, radius in truth.specks:
        own = np.hypot(x - cx, y - cy) < max(2 * radius, 1.5)
        specks += bool((bad & own).any())
        near |= np.hypot(x - cx, y - cy) < 5 * radius
    return [int((bad & hot).sum()), specks, int((bad & ~near).sum())]


def scene_light(capture: Capture) -> NDArray[Any]:
    """(h, w) true light of the pixels of a simulated capture, as it is stored."""
    camera = capture.camera
    gamma = bool(capture.recipe["gamma"])
    blank = SCENES["blank"](camera)
    return simulate(blank, camera, samples=_TRUE_RAYS, gamma=gamma, bits=16).white.astype(float)


def clean_whites(seed: int) -> Iterator[tuple[str, WhiteImage]]:
    """Random white images without defects."""
    for name, truth in random_cases(_WHITES, seed).items():
        yield name, replace(truth, hot=0, dust=0, size=_SIZE)


def main(arguments: list[str]) -> None:
    """Print the tables."""
    seed = int(arguments[0]) if arguments else 31
    print(f"{'white image':52s} {'RMS':>8s} {'worst':>7s} {'covered':>7s} {'false defects':>13s}")
    errors = []
    false = []
    for name, truth in clean_whites(seed):
        try:
            camera = lfcal.calibrate(truth.image(), kind="white")
        except lfcal.LightFieldError as error:
            print(f"{name:52s} {error}", flush=True)
            continue
        found = compare_gain(camera, truth.light(), each_lens=False)
        false.append(len(camera.defects.pixels))
        errors.append(found)
        row = f"{found.rms:8.4f} {found.most:7.3f} {found.covered:7.3f} {false[-1]:13d}"
        print(f"{name:52s} {row}", flush=True)
    print_mean(errors)
    print(f"{sum(false)} false defects in {len(false)} white images\n")
    print(f"{'scene':52s} {'RMS':>8s} {'worst':>7s} {'covered':>7s}")
    errors = []
    for number in range(_SCENES):
        name, capture = draw(1000 * seed + number, _RAYS)
        try:
            camera = lfcal.calibrate(capture.flat)
        except lfcal.LightFieldError as error:
            print(f"{name:52s} {error}", flush=True)
            continue
        found = compare_gain(camera, scene_light(capture), each_lens=True)
        errors.append(found)
        row = f"{found.rms:8.4f} {found.most:7.3f} {found.covered:7.3f}"
        print(f"{name:52s} {row}", flush=True)
    print_mean(errors)
    print(f"\n{'dirty white image':52s} {'hot of 300':>10s} {'specks of 40':>12s} {'beside':>7s}")
    for name, truth in standard_cases().items():
        if truth.dust:
            image = truth.image()
            counts = count_found(lfcal.calibrate(image, kind="white"), truth, image)
            print(f"{name:52s} {counts[0]:10d} {counts[1]:12d} {counts[2]:7d}", flush=True)


def print_mean(errors: list[GainErrors]) -> None:
    """Print the mean of the errors of a table."""
    mean = np.mean([(one.rms, one.most, one.covered) for one in errors], axis=0)
    print(f"{'mean':52s} {mean[0]:8.4f} {mean[1]:7.3f} {mean[2]:7.3f}")


if __name__ == "__main__":
    main(sys.argv[1:])
