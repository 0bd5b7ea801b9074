"""The picture whose microimages, blurred by the lenses and sampled by the pixels, are those of the flat.

From a picture the flat is predicted: each pixel shows the place that its lens and the depth there tell, blurred by the
disc of its type and by itself. What the flat shows beyond that is drawn as a picture, with the weights and occlusion of
`render`, and added; a few rounds (L. Landweber 1951), after which noise would grow, begin at the linear filter.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from ..data.surface import edge_step, sample_surface_at
from ..flat.gray_flat import white_level
from .defocus import Defocus
from .restore import off_edges
from .settings import RESTORE, SOLVE, SolveSettings
from .spectra import is_encoded

if TYPE_CHECKING:
    from ..rendering.plan import RenderPlan

__all__ = ["solve_detail"]


def solve_detail(
    plan: RenderPlan, pixels: NDArray[Any], settings: SolveSettings = SOLVE
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """As `RenderPlan.draw`, of the whole picture, (rows, columns, C) float32.

    Where a picture is coarser than the flat, beside depth edges and in blank places it is that of the linear filter.
    """
    import cv2

    assert plan.defocus is not None
    plain = replace(plan, defocus=None, solved=False)
    found, valid = replace(plan, solved=False).draw(pixels)
    step = edge_step(plan.calibration.lattice.pitch)
    sizes = sample_surface_at(plan.surface, step, valid.shape, plan.affine[:, 2], plan.spacing)
    least, full = settings.fine
    fine = np.clip((plan.scale / np.maximum(np.abs(sizes), 1) - least) / (full - least), 0, 1)
    if not fine.any():
        return found, valid
    natural = found.copy()
    image, _ = plain.draw(pixels)
    # What is predicted has even light.
    even = replace(plain, calibration=replace(plan.calibration, vignetting=None, gain_map=None))
    places, kinds = _seen_places(plan, sizes)
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
        found += image - even.draw(seen.astype(pixels.dtype))[0]
    side = np.array([settings.smooth, 1 - 2 * settings.smooth, settings.smooth], np.float32)
    added = cv2.sepFilter2D(found - natural, -1, side, side, borderType=cv2.BORDER_REFLECT_101)
    found = natural + added.reshape(image.shape)
    around = np.ones((3, 3), np.uint8)
    low, high = (cut(image, around).reshape(image.shape) for cut in (cv2.erode, cv2.dilate))
    beyond = settings.overshoot * (high - low)
    found = np.clip(found, low - beyond, high + beyond)
    share = fine * _trusted(image / white_level(pixels, plan.calibration), valid, sizes, plan, settings)
    return (natural + share[..., None] * (found - natural)).astype(np.float32), valid


def _seen_places(
    plan: RenderPlan, sizes: NDArray[np.float32]
) -> tuple[tuple[NDArray[np.float32], NDArray[np.float32]], NDArray[np.int8]]:
    """Columns and rows of the picture that each pixel of the flat shows, and the type of its lens."""
    import cv2

    lattice, types = plan.calibration.lattice, plan.calibration.lens_types
    width, height = lattice.image_size
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    pixel = np.stack([columns.ravel(), rows.ravel()], -1).astype(np.float64)
    index, centre = _nearest_lens(plan.calibration, pixel)
    size = plan.surface.at(centre)
    for _ in range(3):
        place = centre - (pixel - centre) * (lattice.pitch / np.where(size == 0, 1e-3, size))[:, None]
        at = ((place - plan.affine[:, 2]) / plan.spacing).astype(np.float32).reshape(height, width, 2)
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
    import cv2

    pitch = plan.calibration.lattice.pitch
    out = picture.copy()
    for sign in (-1, 1):
        places = np.sign(sizes) == sign
        if not places.any():
            continue
        ratio = np.maximum(np.abs(sizes) / pitch, RESTORE.least_ratio)
        ends = np.quantile(ratio[places], settings.depths)
        levels = np.linspace(ends[0], ends[1], settings.levels if ends[1] - ends[0] > settings.one_depth else 2)
        blurred = []
        for level in levels:
            grown = plan.scale / (level * pitch)
            disc = defocus.diameters(sign * float(level))[kind] * grown
            # A pixel of the picture is a mean over its own square.
            blurred.append(
                cv2.filter2D(
                    picture,
                    -1,
                    _point_spread(disc, float(np.sqrt(max(grown**2 - 1, 0.0)))),
                    borderType=cv2.BORDER_REFLECT_101,
                )
            )
        at = np.clip((ratio - levels[0]) / max(levels[1] - levels[0], 1e-6), 0, len(levels) - 1).astype(np.float32)
        for n, (one, other) in enumerate(pairwise(blurred)):
            here = places & (at >= n) & (at <= n + 1)
            share = (at[here] - n)[:, None]
            out[here] = ((1 - share) * one.reshape(out.shape)[here]) + share * other.reshape(out.shape)[here]
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
    settings: SolveSettings,
) -> NDArray[np.float32]:
    """(rows, columns) how much of the solution is taken: nothing beside depth edges and the border, and in blanks."""
    import cv2

    lattice, (rows, columns) = plan.calibration.lattice, valid.shape
    share = off_edges(valid, sizes, lattice.pitch, replace(RESTORE, beside_edge=settings.beside_edge))
    beside = [np.minimum(np.arange(n) + 0.5, n - 0.5 - np.arange(n)) / plan.scale for n in (rows, columns)]
    share *= np.clip(np.minimum(beside[0][:, None], beside[1]) / RESTORE.border - 1, 0, 1)
    reach = np.minimum(lattice.radius * lattice.pitch / np.maximum(np.abs(sizes), 1), plan.reach * lattice.pitch)
    views = 0.75 * np.pi * reach**2 / abs(float(np.linalg.det(lattice.basis)))
    low, high = RESTORE.few_views
    share *= np.clip((views - low) / (high - low), 0, 1)
    fine = (image - cv2.GaussianBlur(image, (0, 0), 1.5).reshape(image.shape)) ** 2
    power = cv2.blur(fine.mean(2), (5, 5))
    return np.asarray(share * np.clip(1 - settings.contrast**2 / np.maximum(power, 1e-12), 0, 1), np.float32)
