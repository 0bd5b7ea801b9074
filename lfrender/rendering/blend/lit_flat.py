"""What a picture reads of a flat: its pixels without the gain of the lenses, and the patch size that each shows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...flat.gray_flat import correction_cell, has_uneven_lenses
from ...flat.prefilter import prefilter_packed
from .blend_pixels import Light
from .occlusion import project_surface

if TYPE_CHECKING:
    from ..plan import RenderPlan

__all__ = ["LitFlat", "dilate_mask", "light_flat"]


@dataclass(frozen=True)
class LitFlat:
    """What a picture reads of a flat."""

    pixels: NDArray[Any]  # (h, w, C), divided by the gain if that differs from lens to lens
    shown: NDArray[np.float32]  # (h, w) patch size that each pixel shows [px]; (0, 0) if nothing occludes
    light: Light
    edged: NDArray[np.bool_]  # (n,) `shown` is set on the pixels of these lenses

    @cached_property
    def packed(self) -> NDArray[Any]:
        """(h, w) the pixels for `blend_rows`."""
        return prefilter_packed(self.pixels)


def light_flat(
    plan: RenderPlan, pixels: NDArray[Any], corner: tuple[int, int], following: bool, parallax: float | None = None
) -> LitFlat:
    """The pixels, the patch size that each shows, and the light of the lenses.

    If the gain differs from lens to lens, pixels are divided by it, and those that are unlit are infinitely far.
    The memory is that of the next picture, unless the `parallax` of several is given.

    Parameters
    ----------
    plan : RenderPlan
    pixels : (h, w, C) array
        Part of the flat.
    corner : (int, int) [px]
        Flat coordinates x, y of its first pixel.
    following : bool
        The surface differs in some places only from that of the picture before.
    parallax : float, optional [px]
    """
    camera = plan.calibration
    edged = np.zeros(len(camera.lattice), bool)
    uneven = camera.region_gain() if has_uneven_lenses(camera) else None
    # Unlit pixels are entered if the light differs from lens to lens: that memory is another.
    purpose = "seen depth" if uneven is None else "seen depth and light"
    following &= uneven is None
    shown = _shown_depth(plan, corner, pixels.shape, edged, following, purpose, parallax)
    gains, step = plan.gains
    lights = 1 / gains
    if uneven is not None:
        gains = np.ones_like(gains)
        pixels, unknown = uneven.flatten(pixels, *corner)
        if not shown.size:
            shown = np.full(pixels.shape[:2], np.nan, np.float32)
        shown[dilate_mask(unknown)] = np.inf
        edged[:] = True
    return LitFlat(pixels, shown, Light(gains, lights, np.float32(step), correction_cell(camera)), edged)


def _shown_depth(
    plan: RenderPlan,
    corner: tuple[int, int],
    shape: tuple[int, ...],
    edged: NDArray[np.bool_],
    following: bool,
    purpose: str,
    parallax: float | None,
) -> NDArray[np.float32]:
    """Patch size that each pixel of a part of the flat shows, (0, 0) if nothing can occlude anything.

    Sets the lenses that are `edged` (n,): on the others it is not known.
    """
    if not plan.blend or plan.surface.patch_size.size <= 1:
        return np.empty((0, 0), np.float32)
    lattice = plan.calibration.lattice
    reach = plan.reach * lattice.pitch + (plan.parallax if parallax is None else parallax)
    part = (*corner, corner[0] + shape[1], corner[1] + shape[0])
    whole = shape[:2] == plan.calibration.image_size[::-1]
    return project_surface(
        plan.surface, lattice, reach, plan.edge, None if whole else part, edged,
        purpose if parallax is None else None, following,
    )  # fmt: skip


def dilate_mask(pixels: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """These pixels and their neighbours, whose interpolation needs them."""
    import cv2

    return cv2.dilate(pixels.view(np.uint8), np.ones((3, 3), np.uint8)).view(bool)
