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

from lfcal import Calibration

from ..data.surface import edge_step, sample_surface_at
from ..flat.gray_flat import white_level
from .defocus import Defocus
from .draw import plan_border
from .filters import averaged_views, trusted_share
from .restore import convolve, off_edges, smooth_picture
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
    places, kinds = _seen_places(plan, sizes, wide, corner, pixels.shape[:2])
    encoded = is_encoded(pixels.dtype)
    for _ in range(settings.rounds):
        seen = np.zeros(pixels.shape, np.float32)
        light = np.maximum(found, 0) ** 2 if encoded else found
        for kind in range(len(plan.defocus.discs)):
            blurred = _blur(light, sizes, plan, plan.defocus, kind, settings)
            shown = cv2.remap(blurred, *places, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
            shown = np.sqrt(np.maximum(shown, 0)) if encoded else shown
            np.copyto(seen, shown.reshape(seen.shape), where=(kinds == kind)[..., None])
        if pixels.dtype.kind in "ui":
            seen = np.clip(np.rint(seen), 0, np.iinfo(pixels.dtype).max)
        found += image - even.draw(seen.astype(pixels.dtype), corner, wide)[0]
    found = natural + smooth_picture(found - natural)
    around = np.ones((3, 3), np.uint8)
    low, high = (cut(image, around).reshape(image.shape) for cut in (cv2.erode, cv2.dilate))
    beyond = settings.overshoot * (high - low)
    found = np.clip(found, low - beyond, high + beyond)
    share = fine * _trusted(image / white_level(pixels, plan.calibration), valid, sizes, plan, wide, settings)
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


def _seen_places(
    plan: RenderPlan, sizes: NDArray[np.float32], part: Part, corner: tuple[int, int], shape: tuple[int, ...]
) -> tuple[tuple[NDArray[np.float32], NDArray[np.float32]], NDArray[np.int8]]:
    """Columns and rows of a part of the picture that each pixel of the flat shows, and the type of its lens."""
    import cv2

    lattice, types = plan.calibration.lattice, plan.calibration.lens_types
    height, width = shape[:2]
    rows, columns = np.mgrid[corner[1] : corner[1] + height, corner[0] : corner[0] + width]
    pixel = np.stack([columns.ravel(), rows.ravel()], -1).astype(np.float64)
    index, centre = _nearest_lens(plan.calibration, pixel)
    size = plan.surface.at(centre)
    for _ in range(3):
        place = centre - (pixel - centre) * (lattice.pitch / np.where(size == 0, 1e-3, size))[:, None]
        # In 32nds, as `remap` rounds them, before the part begins at zero: all parts get the same.
        at = np.rint((place - plan.affine[:, 2]) * (32 / plan.spacing)) / 32 - np.array(part[:2])
        at = np.clip(at, -1e4, 1e5).astype(np.float32).reshape(height, width, 2)
        u, v = np.ascontiguousarray(at[..., 0]), np.ascontiguousarray(at[..., 1])
        near = cv2.remap(sizes, u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
        size = near.astype(np.float32).ravel()
    kinds = np.zeros(len(index), np.int8) if types is None else types.of(index)
    return (u, v), kinds.reshape(height, width)


def _nearest_lens(
    calibration: Calibration, pixel: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Indices and centres (n, 2) of the lenses nearest to places (n, 2)."""
    lattice = calibration.lattice
    low = np.floor(lattice.to_index(pixel)).astype(np.int64)
    index, centre, least = low, np.zeros_like(pixel), np.full(len(pixel), np.inf)
    for corner in ((0, 0), (0, 1), (1, 0), (1, 1)):
        other = low + corner
        there = lattice.points(other)
        distance = ((pixel - there) ** 2).sum(1)
        nearer = distance < least
        least = np.where(nearer, distance, least)
        index, centre = (np.where(nearer[:, None], *pair) for pair in ((other, index), (there, centre)))
    return index, centre


def _blur(
    picture: NDArray[np.float32],
    sizes: NDArray[np.float32],
    plan: RenderPlan,
    defocus: Defocus,
    kind: int,
    settings: SolveSettings,
) -> NDArray[np.float32]:
    """A picture as lenses of one type and the pixels of the flat see it, at the depth of each place."""

    pitch = plan.calibration.lattice.pitch
    out = picture.copy()
    # Depths at which pictures are blurred: those of the whole, for any part.
    levels = np.geomspace(RESTORE.least_ratio, RESTORE.largest_ratio, settings.levels)
    step = np.log(levels[1] / levels[0])
    at = np.log(np.clip(np.abs(sizes) / pitch, levels[0], levels[-1]) / levels[0]) / step
    low = np.minimum(at.astype(np.int64), len(levels) - 2)
    share = (at - low).astype(np.float32)[..., None]
    signs = np.sign(sizes)
    for sign in (-1, 1):
        blurred: dict[int, NDArray[np.float32]] = {}
        for n in np.unique(low[signs == sign]).tolist():
            for k in (n, n + 1):
                if k not in blurred:
                    grown = plan.scale / (levels[k] * pitch)
                    disc = float(defocus.diameters(sign * float(levels[k]))[kind]) * grown
                    # A pixel of the picture is a mean over its own square.
                    kernel = _point_spread(disc, float(np.sqrt(max(grown**2 - 1, 0.0))))
                    blurred[k] = convolve(picture, kernel)
            here = (signs == sign) & (low == n)
            out[here] = ((1 - share) * blurred[n] + share * blurred[n + 1])[here]
    return out


def _point_spread(disc: float, pixel: float) -> NDArray[np.float32]:
    """Kernel of a disc of this diameter, averaged over a square of this side [px]."""
    finer, half = 9, int(np.ceil((disc + pixel) / 2))
    wide = (2 * half + 1) * finer
    at = (np.arange(wide) - (wide - 1) / 2) / finer
    kernel = (np.hypot(at[:, None], at) <= max(disc / 2, 0.6 / finer)).astype(np.float64)
    box = np.ones(max(1, round(pixel * finer)))
    for _ in range(2):
        kernel = np.stack([np.convolve(row, box, "same") for row in kernel]).T
    kernel = kernel.reshape(2 * half + 1, finer, 2 * half + 1, finer).sum((1, 3))
    return np.asarray(kernel / kernel.sum(), np.float32)


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
