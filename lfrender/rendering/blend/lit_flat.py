"""What a picture reads of a flat: its pixels without the gain of the lenses, and the patch size
that each shows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from ...data.surface import Surface, edge_step
from ...flat.gray_flat import correction_tables, has_uneven_lenses
from ...flat.prefilter import pack_flat, prefilter_flat
from .occlusion import project_surface
from .records import Light

__all__ = ["LitFlat", "dilate_mask", "light_flat"]


@dataclass(frozen=True)
class LitFlat:
    """What a picture reads of a flat."""

    pixels: NDArray[Any]  # (h, w, C), divided by the gain if that differs from lens to lens
    edged: NDArray[np.bool_]  # (n,) lenses with a depth edge in sight, or unlit pixels
    shown: NDArray[
        np.float32
    ]  # (h, w) patch size [px] that pixels of these lenses show, inf where unlit
    light: Light
    sharpened: bool  # pixels are read sharpened: the mean over lenses takes that back

    @cached_property
    def packed(self) -> NDArray[Any]:
        """(h, w) the pixels for `blend_rows`."""
        return pack_flat(self.pixels, self.sharpened)

    @property
    def unpacked(self) -> NDArray[Any]:
        """(h, w, C) the pixels for `blend_pixels`, with four channels if they are integers."""
        if self.pixels.dtype.kind in "ui":
            return self.packed.view(self.pixels.dtype).reshape(*self.packed.shape, 4)
        return prefilter_flat(self.pixels) if self.sharpened else self.pixels


def light_flat(
    calibration: Calibration,
    surface: Surface | None,
    pixels: NDArray[Any],
    corner: tuple[int, int],
    reach: float,
) -> LitFlat:
    """The pixels (h, w, C) of a part of the flat from `corner` on, the patch size that each shows,
    and the light of the lenses.

    If the gain differs from lens to lens, pixels are divided by it, and those that are unlit are
    infinitely far. Without a surface nothing occludes anything, and lenses are read alone. `reach` [px] is from lenses to
    scene points that are read from them.
    """
    lattice = calibration.lattice
    shown = np.empty((0, 0), np.float32)
    edged = np.zeros(len(lattice), bool)
    uneven = has_uneven_lenses(calibration)
    if surface is not None and surface.patch_size.size > 1:
        part = (*corner, corner[0] + pixels.shape[1], corner[1] + pixels.shape[0])
        shown, edged = project_surface(
            surface, lattice, reach, edge_step(lattice.pitch), part, uneven
        )
    gains, step = correction_tables(calibration)
    if uneven:
        pixels, unknown = calibration.region_gain().flatten(pixels, *corner)
        if not shown.size:
            shown = np.full(pixels.shape[:2], np.nan, np.float32)
        shown[dilate_mask(unknown)] = np.inf
        edged[:] = True
    light = Light(gains, np.float32(step), np.float32(0 if uneven else 1))
    return LitFlat(pixels, edged, shown, light, sharpened=surface is not None)


def dilate_mask(pixels: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """These pixels and their neighbours, whose interpolation needs them."""
    import cv2

    return cv2.dilate(pixels.view(np.uint8), np.ones((3, 3), np.uint8)).view(bool)
