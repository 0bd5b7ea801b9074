"""The depth of every scene point from the depths of the lenses around it, with depth edges located
on the pixels.

Lenses that agree are interpolated. Where they do not, each of their depths is a hypothesis whose
mismatch is measured on the pixels, and semi-global matching (Hirschmueller, Stereo processing by
semiglobal matching and mutual information, 2008) along rows and columns chooses one per point.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal import Lattice
from lfcal.runtime.kernels import FAST, kernel

from ...data.surface import Surface
from ...flat.gray_flat import GrayFlat
from ...flat.neighbours import neighbours_of
from ..same_surface import TOLERANCE, same_surface
from .hypotheses import MAX_HYPOTHESES, propose_hypotheses
from .scene_grid import PointGrid, grid_shape, lens_array

__all__ = ["densify"]


@njit(fastmath=FAST, forceinline=True)
def _aggregate(depths, costs, single, gap, jump, total):
    """Add one path of semi-global matching along a line of scene points to `total`; a `single`
    hypothesis is chosen anyway.
    """
    most = len(depths)
    message = np.zeros(most, np.float32)
    previous = np.zeros(most, np.float32)
    low = np.float32(0.0)
    for p in range(depths.shape[1]):
        if single[p]:
            previous[0] = low = np.float32(0.0)
            continue
        lowest = np.float32(np.inf)
        for k in range(most):
            s = depths[k, p]
            # Hypotheses come first, unused places after them.
            if np.isnan(s):
                break
            best = np.float32(0.0)
            if p > 0:
                best = jump
                for q in range(1 if single[p - 1] else most):
                    t = depths[q, p - 1]
                    if np.isnan(t):
                        break
                    best = min(
                        best,
                        previous[q] - low + (np.float32(0.0) if same_surface(s, t, gap) else jump),
                    )
            message[k] = costs[k, p] + best
            total[k, p] += message[k]
            lowest = min(lowest, message[k])
        low = lowest
        for k in range(most):
            previous[k] = message[k]


@kernel(error_model="numpy", share=lambda depths, *_: depths.shape[1])
def _follow_lines(begin, end, depths, costs, gap, jump, single, total, fresh, out):
    """Add the paths along each line of scene points, both ways, to `total`, which is cleared first
    if `fresh`; or else set `out` to the cheapest hypothesis of each point.
    """
    most, _, places = depths.shape
    for v in range(begin, end):
        some = False
        for u in range(places):
            some = some or not single[v, u]
            if fresh and not single[v, u]:
                for k in range(most):
                    total[k, v, u] = 0.0
        if some:
            _aggregate(depths[:, v], costs[:, v], single[v], gap, jump, total[:, v])
            _aggregate(
                depths[:, v, ::-1], costs[:, v, ::-1], single[v, ::-1], gap, jump, total[:, v, ::-1]
            )
        if fresh:
            continue
        for u in range(places):
            best = 0
            if not single[v, u]:
                for k in range(1, most):
                    if np.isnan(depths[k, v, u]):
                        break
                    if total[k, v, u] < total[best, v, u]:
                        best = k
            out[v, u] = depths[best, v, u]


def _choose(
    depths: NDArray[np.float32], costs: NDArray[np.float32], gap: np.float32, jump: np.float32
) -> NDArray[np.float32]:
    """Choose one hypothesis per scene point by paths along its row and column, both ways."""
    single = np.isnan(depths[1])
    total = np.empty_like(costs)
    out = np.empty(costs.shape[1:], np.float32)
    columns, column_costs, column_total = (
        values.transpose(0, 2, 1) for values in (depths, costs, total)
    )
    _follow_lines(
        columns, column_costs, gap, jump, np.ascontiguousarray(single.T), column_total, True, out
    )
    _follow_lines(depths, costs, gap, jump, single, total, False, out)
    return out


def densify(
    gray: GrayFlat,
    lattice: Lattice,
    values: NDArray[np.float32],
    seconds: NDArray[np.float32],
    trust: NDArray[np.float32],
    noise: float,
    cells: int,
    unchanged: NDArray[np.bool_] | None = None,
    before: Surface | None = None,
) -> Surface:
    """Patch size of every scene point from the patch sizes of the lenses around it, on so many
    `cells` per pitch.

    First on a grid of twice the spacing, then between its values where these differ. Given are the
    patch size (n,) [px] of each lens; a second one (n,) that it may show, NaN where there is none;
    its weight `trust` (n,); and the `noise` of a pixel. Lenses that are `unchanged` (n,) have
    surroundings as in the surface `before`, if that is of the whole flat.
    """
    shape, start, spacing = grid_shape(lattice, cells)
    lenses = lens_array(lattice, TOLERANCE * lattice.pitch, gray.radius)
    gap = np.float32(lenses.gap)
    # Weights are positive, for means over them: a depth NaN would be looked up beyond the flat.
    table = np.column_stack([gray.centres, np.maximum(trust, 1e-3), values, seconds]).astype(
        np.float32
    )
    around = neighbours_of(lattice).rows(lenses.ring)
    agreeing = _agree(values, seconds, around, gap)
    old = None
    if (
        before is not None
        and unchanged is not None
        and before.patch_size.shape == shape
        and before.first == start
    ):
        old = before.patch_size

    def settle(
        part: float, coarse: NDArray[np.float32], old: NDArray[np.float32] | None
    ) -> tuple[NDArray, NDArray]:
        rows, columns = shape if coarse.size else (shape[0] // 2 + 1, shape[1] // 2 + 1)
        depths, costs = (np.empty((MAX_HYPOTHESES, rows, columns), np.float32) for _ in range(2))
        depths[1] = np.nan
        open_ = (
            _interpolate(coarse, gap, depths[0]) if coarse.size else np.ones((rows, columns), bool)
        )
        points = PointGrid(start[0], spacing / part)
        if old is not None and unchanged is not None:
            changed = _mark_places(gray.centres[~unchanged], old.shape, points, lattice.pitch)
            open_ &= changed
            np.copyto(depths[0], old, where=~changed)
        # Pixels that differ by no more than twice their noise match.
        floor = np.float32(4 * noise * noise)
        propose_hypotheses(gray.image, table, agreeing, lenses, points, floor, depths, costs, open_)
        # A depth edge costs 0.35 in units of the mismatch. A step of a coarser grid stands for
        # several steps, and so does its mismatch: both are scaled alike.
        return depths, _choose(depths, costs, gap, np.float32(0.35 * part))

    # Points between values of twice the spacing that agree are interpolated: only depth edges are
    # computed in full.
    some = (
        None
        if old is None
        else np.pad(old[::2, ::2], [(0, 1)] * 2, "edge")[: shape[0] // 2 + 1, : shape[1] // 2 + 1]
    )
    _, coarse = settle(0.5, np.empty((0, 0), np.float32), some)
    depths, chosen = settle(1.0, coarse, old)
    # Points with several hypotheses that differ from most points about them are specks.
    usual = cv2.medianBlur(chosen, 3)
    speck = ~np.isnan(depths[1]) & ~same_surface(chosen, usual, gap)
    return Surface(np.where(speck, usual, chosen), start, spacing)


def _mark_places(
    centres: NDArray[np.float32], shape: tuple[int, ...], grid: PointGrid, pitch: float
) -> NDArray[np.bool_]:
    """(rows, columns) bool: grid values within a pitch of some `centres` (m, 2) each way."""
    places = np.zeros(shape, np.uint8)
    side = 2 * int(np.ceil(pitch / grid.spacing)) + 1
    u, v = np.rint((centres - grid.first) / grid.spacing).astype(int).T
    places[np.clip(v, 0, shape[0] - 1), np.clip(u, 0, shape[1] - 1)] = 1
    return np.asarray(cv2.dilate(places, np.ones((side, side), np.uint8)) > 0)


def _agree(
    values: NDArray[np.float32],
    seconds: NDArray[np.float32],
    around: NDArray[np.integer],
    gap: np.float32,
) -> NDArray[np.bool_]:
    """(n,) bool: where all lenses `around` (n, k) agree to one `gap` and have no second depths."""
    near = np.where(around >= 0, values[around], values[:, None])
    several = np.isfinite(seconds)
    alone = ~(several[around] & (around >= 0)).any(1) & ~several
    return np.asarray(alone & (near.max(1) - near.min(1) <= gap))


def _interpolate(
    coarse: NDArray[np.float32], gap: np.float32, out: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Fill `out` with the means of the values of a grid of twice the spacing about each point;
    where those differ by more than a `gap`.
    """
    differ = np.empty(out.shape, np.bool_)
    for row, column in np.ndindex(2, 2):
        beside = np.ones((3 - row, 3 - column), np.uint8)
        anchor = (1 - column, 1 - row)
        low = cv2.erode(coarse, beside, anchor=anchor)
        high = cv2.dilate(coarse, beside, anchor=anchor)
        rows, columns = out[row::2, column::2].shape
        mean = cv2.blur(
            coarse, (1 + column, 1 + row), anchor=(0, 0), borderType=cv2.BORDER_REPLICATE
        )
        out[row::2, column::2] = mean[:rows, :columns]
        # Beyond the flat the coarse grid may reach where no lens looks: there OpenCV gives the ends
        # of all numbers.
        with np.errstate(over="ignore"):
            apart = ~same_surface(low, high, gap) | np.isnan(mean)
        differ[row::2, column::2] = apart[:rows, :columns]
    return differ
