"""The picture whose microimages, blurred by the lenses and sampled by the pixels, are those of the flat.

From a picture the flat is predicted: each pixel shows the place that its lens and the depth there tell, blurred by the
disc of its type and by itself. What the flat shows beyond that is drawn as a picture, with the weights and occlusion of
`render`, and added; a few rounds (L. Landweber 1951), after which noise would grow, begin at the linear filter.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..data.surface import edge_step, sample_surface_at
from ..flat.gray_flat import white_level
from .draw import plan_border
from .filters import averaged_views, trusted_share
from .predict import FlatModel
from .restore import off_edges, smooth_picture, spread_clipped
from .settings import RESTORE, SOLVE, SolveSettings
from .spectra import is_encoded

if TYPE_CHECKING:
    from ..rendering.plan import Part, RenderPlan

__all__ = ["solve_detail", "solve_halo"]


def solve_detail(
    plan: RenderPlan,
    pixels: NDArray[Any],
    corner: tuple[int, int] = (0, 0),
    part: Part | None = None,
    settings: SolveSettings = SOLVE,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """As `RenderPlan.draw`, (rows, columns, C) float32. A part is solved with a halo, and has the bits of the whole.

    Where a picture is coarser than the flat, beside depth edges and in blank places it is that of the linear filter.
    """
    import cv2

    assert plan.defocus is not None
    part = part or (0, 0, *plan.size)
    # Natural pictures and the depth are needed in the halo, too.
    wide = plan.expand_part(part, solve_halo(plan, settings))
    inside = slice(part[1] - wide[1], part[3] - wide[1]), slice(part[0] - wide[0], part[2] - wide[0])
    found, valid = replace(plan, solved=False).draw(pixels, corner, wide)
    sizes = sample_surface_at(
        plan.surface, edge_step(plan.calibration.lattice.pitch), valid.shape,
        plan.affine[:, 2] + plan.spacing * np.array(wide[:2]), plan.spacing,
    )  # fmt: skip
    least, full = settings.least_fine, settings.fine
    fine = np.clip((plan.scale / np.maximum(np.abs(sizes), 1) - least) / (full - least), 0, 1)
    if not fine[inside].any():
        return found[inside], valid[inside]
    natural = found.copy()
    plain = replace(plan, defocus=None, solved=False)
    image, _ = plain.draw(pixels, corner, wide)
    # What is predicted has even light.
    even = replace(plain, calibration=replace(plan.calibration, vignetting=None, gain_map=None))
    model = FlatModel.make(plan, plan.defocus, sizes, wide, corner, pixels.shape, settings)
    encoded = is_encoded(pixels.dtype, plan.calibration)
    for _ in range(settings.rounds):
        found += image - even.draw(model.predict(found, encoded, pixels.dtype), corner, wide)[0]
    added = found - natural
    found = natural + (1 - settings.smooth) * added + settings.smooth * smooth_picture(added)
    around = np.ones((3, 3), np.uint8)
    low, high = (cut(image, around).reshape(image.shape) for cut in (cv2.erode, cv2.dilate))
    white = white_level(pixels, plan.calibration)
    beyond = settings.overshoot * (high - low)
    beyond[spread_clipped(image, white) == 255] = 0
    found = np.clip(found, low - beyond, high + beyond)
    share = fine * _trusted(image / white, valid, sizes, plan, wide, settings)
    solved = (natural + share[..., None] * (found - natural)).astype(np.float32)
    return np.ascontiguousarray(solved[inside]), np.ascontiguousarray(valid[inside])


def solve_halo(plan: RenderPlan, settings: SolveSettings = SOLVE) -> int:
    """How far around a place its solution depends on the picture [px]."""
    lattice, sizes = plan.calibration.lattice, np.abs(plan.surface.patch_size)
    smallest = max(float(sizes.min()) / lattice.pitch, RESTORE.least_ratio)
    discs = [plan.defocus.diameters(sign * RESTORE.largest_ratio) for sign in (-1, 1)] if plan.defocus else [0.0]
    blur = plan.scale / (smallest * lattice.pitch) * (1 + float(np.max(discs))) / 2
    # A lens within reach shows a place, and others as far as its radius over the patch size.
    seen = plan.scale * (plan.reach + lattice.radius / lattice.pitch / smallest)
    return settings.rounds * int(np.ceil(seen + blur + settings.kernel)) + settings.beside_edge + settings.kernel


def _trusted(
    image: NDArray[Any],
    valid: NDArray[np.bool_],
    sizes: NDArray[np.float32],
    plan: RenderPlan,
    part: Part,
    settings: SolveSettings,
) -> NDArray[np.float32]:
    """(rows, columns) how much of the solution is taken: nothing beside depth edges and the border, and in blanks."""
    lattice = plan.calibration.lattice
    share = off_edges(valid, sizes, lattice.pitch, replace(RESTORE, beside_edge=settings.beside_edge))
    share *= plan_border(plan, part)
    views = averaged_views(np.maximum(np.abs(sizes), 1) / lattice.pitch, plan.calibration, plan.reach)
    share *= trusted_share(views).astype(np.float32)
    mean = image
    for _ in range(4):
        mean = smooth_picture(mean)
    power = ((image - mean) ** 2).mean(2, keepdims=True)
    for _ in range(3):
        power = smooth_picture(power)
    return np.asarray(share * np.clip(1 - settings.contrast**2 / np.maximum(power[..., 0], 1e-12), 0, 1), np.float32)
