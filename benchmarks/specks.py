"""Specks in pictures of real captures: `python -m benchmarks.specks ../shared/captures/Wall.png
...`.

A speck is an isolated spot, at most three pixels wide, brighter or darker than the ring of pixels
around it, if neither single lenses nor pictures from nearby viewpoints show it. For this test each
lens is tiled with its own patch size, not with that of the surface. The command prints specks per
megapixel of the middle picture and of two outer views, and the processor time of `analyze`.
Pictures are drawn without restored detail.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

import lfcal
import lfrender
from lfcal import Calibration
from lfrender.data.surface import Surface
from lfrender.flat.lens_graph import nearest_lens

__all__ = ["find_specks", "main", "specks_per_megapixel"]

# [white] contrast that is seen on a plain wall at 100 %: six levels of 255.
_SEEN = 0.025
# [radius] from a viewpoint to those close by, and to the outer views.
_NEAR = 0.12
_OUTER = 0.7


def find_specks(
    picture: NDArray[np.floating], references: list[NDArray[np.floating]]
) -> NDArray[np.bool_]:
    """(h, w) bool: pixels of isolated spots of a `picture` (h, w) that no reference has within a
    pixel; white = 1.
    """
    ring = np.ones((5, 5), np.uint8)
    ring[1:4, 1:4] = 0
    around = np.ones((3, 3), np.uint8)
    spots = np.zeros(picture.shape, bool)
    for sign in (1, -1):
        here = (sign * picture).astype(np.float32)
        known = np.max(
            [cv2.dilate((sign * one).astype(np.float32), around) for one in references], axis=0
        )
        spots |= (here > cv2.dilate(here, ring) + _SEEN) & (here > known + _SEEN)
    spots[:3], spots[-3:], spots[:, :3], spots[:, -3:] = False, False, False, False
    return spots


def _grey(picture: lfrender.Rendering) -> NDArray[np.float32]:
    image = picture.image.reshape(*picture.image.shape[:2], -1).mean(2)
    white = np.iinfo(picture.image.dtype).max if picture.image.dtype.kind in "ui" else 1.0
    return (image / white).astype(np.float32)


def _lens_depth(depth: lfrender.DepthMap, calibration: Calibration) -> lfrender.DepthMap:
    """The depth map with a surface of one patch size for the cell of each lens."""
    surface = depth.surface
    lattice = calibration.lattice
    v, u = np.mgrid[: surface.patch_size.shape[0], : surface.patch_size.shape[1]] * surface.spacing
    rows = nearest_lens(
        lattice.centres(), np.stack([u + surface.first[0], v + surface.first[1]], -1).reshape(-1, 2)
    )
    values = depth.filled_patch_size[rows].reshape(u.shape).astype(np.float32)
    return replace(depth, surface=Surface(values, surface.first, surface.spacing))


def specks_per_megapixel(
    flat: NDArray, calibration: Calibration, depth: lfrender.DepthMap
) -> tuple[float, float, NDArray[np.bool_]]:
    """Specks per megapixel of the picture and, in the mean, of two outer views; and where they are
    in the picture.
    """
    radius = calibration.lattice.radius
    light = match_white(flat)
    lenses = _lens_depth(depth, calibration)

    def draw(place: tuple[float, float], which: lfrender.DepthMap = depth) -> NDArray[np.float32]:
        return (
            _grey(
                next(iter(lfrender.views(flat, calibration, which, offsets=[place], still=still)))
            )
            / light
        )

    still = float(np.median(depth.surface.patch_size))
    rates = []
    middle = None
    for x in (0.0, -_OUTER * radius, _OUTER * radius):
        step = _NEAR * radius
        places = [(x + dx, dy) for dx, dy in ((-step, 0.0), (step, 0.0), (0.0, -step), (0.0, step))]
        spots = find_specks(draw((x, 0.0)), [draw((x, 0.0), lenses), *map(draw, places)])
        middle = spots if middle is None else middle
        rates.append(label(spots, np.ones((3, 3)))[1] / spots.size * 1e6)
    assert middle is not None
    return rates[0], float(np.mean(rates[1:])), middle


def match_white(flat: NDArray) -> float:
    """Brightness of the brightest hundredth of a flat, the white of dim captures."""
    white = np.iinfo(flat.dtype).max if flat.dtype.kind in "ui" else 1.0
    return float(np.quantile(flat[::7, ::7], 0.99) / white)


def main() -> None:
    """Print one line for each capture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--preset", default="balanced")
    parser.add_argument("--mosaic", help="colour filters of raw captures, as GBRG")
    arguments = parser.parse_args()
    for path in arguments.files:
        flat = lfcal.read_flat(path)
        how = {} if arguments.mosaic is None else {"mosaic": arguments.mosaic}
        calibration = lfcal.calibrate(flat, **how)
        lfrender.analyze(flat, calibration, arguments.preset)
        start = time.process_time()
        depth = lfrender.analyze(flat, calibration, arguments.preset)
        taken = time.process_time() - start
        middle, outer, _ = specks_per_megapixel(flat, calibration, depth)
        print(
            f"{path.name:28} {middle:8.1f} specks per megapixel, outer views {outer:8.1f}; analyze "
            f"{taken:.2f} s"
        )


if __name__ == "__main__":
    main()
