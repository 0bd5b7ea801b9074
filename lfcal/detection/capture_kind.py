"""Whether flats are white images or scenes.

Microimages of a white image are evenly lit inside: their scatter is small against the depth of the gaps between them.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from ..images.preprocessing import normalise_locally, sqrt_luminance
from ..lattice.cell import Cell
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops, find_lit_lenses
from ..runtime.arrays import Singles
from .first_lattice import FirstLattice

__all__ = ["choose_white_or_scene", "is_evenly_lit"]

_SCATTER_INSIDE = 0.15  # most scatter inside microimages of a white image, over the depth of the gaps
_SCATTER_OF_LIT = 0.09  # the same without dark lenses: scenes have 0.11, white images of dots 0.08


def choose_white_or_scene(lights: list[Singles], start: FirstLattice, kind: str) -> tuple[bool, list[Singles]]:
    """Whether to calibrate on white images, and the luminance pictures (h, w) to use: with `kind` "auto" white ones."""
    if kind != "auto":
        return kind == "white", lights
    if len(lights) == 1:
        height, width = start.brightness.shape
        factor = lights[0].shape[0] // height
        small: Any = cv2.resize(
            lights[0][: factor * height, : factor * width], (width, height), interpolation=cv2.INTER_AREA
        )
        return is_evenly_lit(start.brightness, small, start.lattice.downscaled(factor)), lights
    window = 2 * start.lattice.pitch
    levelled = [normalise_locally(sqrt_luminance(light), window) for light in lights]
    whites = [light for light, own in zip(lights, levelled, strict=True) if is_evenly_lit(own, light, start.lattice)]
    return (True, whites) if whites else (False, lights)


def is_evenly_lit(brightness: Singles | StackedCrops, light: Singles, lattice: Lattice) -> bool:
    """Whether the insides of lit microimages vary by little against the depth of the gaps between them.

    `brightness` (h, w), or crops, is locally normalised (`images.preprocessing.normalise_locally`), `light` (h, w) the
    luminance of the flat, or of these crops.
    """
    return (
        _scatter_inside(brightness, lattice, None) < _SCATTER_INSIDE
        or _scatter_inside(brightness, lattice, light) < _SCATTER_OF_LIT
    )


def _scatter_inside(picture: Singles | StackedCrops, lattice: Lattice, light: Singles | None) -> float:
    """Scatter about the mean at a distance inside microimages, over the depth of the gaps.

    Lenses that are dark on the `light` (h, w), if that is given, are left out.
    """
    crops = StackedCrops.of(picture)
    cell = Cell.of(lattice)
    reach = int(np.ceil(cell.circumradius))
    indices, centres, crop = crops.lenses(lattice, reach + 1)
    places = centres - crops.offsets[crop]
    if light is not None:
        places = places[find_lit_lenses(light, lattice, indices, places, 0.1)]
    places = places[:: max(1, len(places) // 600)]
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    own = (np.column_stack([x, y]) @ cell.normals.T <= 0.5).all(1)
    x, y = x[own], y[own]
    corner = np.rint(places).astype(np.int64)
    values = crops.picture[corner[:, 1, None] + y, corner[:, 0, None] + x].ravel()
    far = np.hypot(x + (corner - places)[:, :1], y + (corner - places)[:, 1:]).ravel()
    width = 0.25  # [px] of the rings of a mean microimage
    ring = (far / width).astype(np.int64)
    count, total, square = (np.bincount(ring, weights) for weights in (None, values, values.astype(float) ** 2))
    known = count > 0
    count, mean, square = count[known], total[known] / count[known], square[known]
    inner = np.flatnonzero(known) * width < 0.5 * lattice.radius
    if not inner.any():
        return float("inf")
    variance = np.maximum(square / count - mean**2, 0)
    return float(np.sqrt(np.average(variance[inner], weights=count[inner]))) / max(float(np.ptp(mean)), 1e-12)
