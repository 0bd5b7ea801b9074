"""From the depth of lenses to the depth of every scene point, edges settled on the pixels."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Lattice
from lfcal.runtime.fastmath import FAST

from ...data.surface import Surface
from ...flat.distorted_lookup import lens_displacements
from ...flat.gray_flat import GrayFlat
from ...flat.lens_graph import lens_grid, neighbour_rows
from ...runtime.buffers import allocate_scratch
from ...runtime.cache import cached
from .hypotheses import MAX_HYPOTHESES, find_agreeing_lenses, propose_hypotheses
from .update_mask import mark_changed_points

__all__ = ["densify", "grid_shape"]

# Lenses within this many pitches vote for depths, those within the second number look at them.
_VOTING, _LOOKING = 1.45, 2.1
# Specks are smaller than about half of a square of so many grid values to each side.
_SPECK = 1
# Price of a depth edge between neighbouring grid values, and of a slant by one gap.
_JUMP, _SLANT = np.float32(0.35), np.float32(0.1)


@njit(cache=True, nogil=True, fastmath=FAST, forceinline=True)
def _walk(depths, costs, single, gap, part, total):
    """One path of semi-global matching over the candidates of a line of scene points.

    Where there is a `single` one it is chosen in any case, and tells the next point no more than its depth. A step
    costs `part` of the prices.
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
            # Candidates come first, unused places after them.
            if np.isnan(s):
                break
            best = np.float32(0.0)
            if p > 0:
                best = part * _JUMP
                for q in range(1 if single[p - 1] else most):
                    t = depths[q, p - 1]
                    if np.isnan(t):
                        break
                    apart = abs(s - t) / gap
                    best = min(best, previous[q] - low + part * min(_JUMP, _SLANT * apart if apart < 1 else _JUMP))
            message[k] = costs[k, p] + best
            total[k, p] += message[k]
            lowest = min(lowest, message[k])
        low = lowest
        for k in range(most):
            previous[k] = message[k]


@njit(cache=True, nogil=True, parallel=True)
def _settle(depths, costs, gap, part, total, out):
    """Choose one candidate per scene point with the support of its row and column, both ways."""
    most, rows, columns = depths.shape
    single, turned = np.empty((rows, columns), np.bool_), np.empty((columns, rows), np.bool_)
    for v in prange(rows):
        some = False
        for u in range(columns):
            only = np.isnan(depths[1, v, u])
            single[v, u] = turned[u, v] = only
            if not only:
                some = True
                for k in range(most):
                    total[k, v, u] = 0.0
        # A line on which no point has two candidates has nothing to settle.
        if some:
            _walk(depths[:, v], costs[:, v], single[v], gap, part, total[:, v])
            _walk(depths[:, v, ::-1], costs[:, v, ::-1], single[v, ::-1], gap, part, total[:, v, ::-1])
    for u in prange(columns):
        if not turned[u].all():
            _walk(depths[:, :, u], costs[:, :, u], turned[u], gap, part, total[:, :, u])
            _walk(depths[:, ::-1, u], costs[:, ::-1, u], turned[u, ::-1], gap, part, total[:, ::-1, u])
    for v in prange(rows):
        for u in range(columns):
            best = 0
            if not single[v, u]:
                for k in range(1, most):
                    if np.isnan(depths[k, v, u]):
                        break
                    if total[k, v, u] < total[best, v, u]:
                        best = k
            out[v, u] = depths[best, v, u]


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _without_specks(chosen, depths, gap, out):
    """Give contested points that most of the points about them contradict the median of those."""
    rows, columns = chosen.shape
    side = 2 * _SPECK + 1
    for v in prange(rows):
        window = np.empty(side * side, np.float32)
        for u in range(columns):
            here = chosen[v, u]
            out[v, u] = here
            if np.isnan(depths[1, v, u]):
                continue
            count = agree = 0
            for y in range(max(0, v - _SPECK), min(rows, v + _SPECK + 1)):
                for x in range(max(0, u - _SPECK), min(columns, u + _SPECK + 1)):
                    window[count] = chosen[y, x]
                    count += 1
                    agree += abs(chosen[y, x] - here) <= gap
            if 2 * agree < count:
                out[v, u] = np.sort(window[:count])[count // 2]


def grid_shape(lattice: Lattice, cells: int) -> tuple[tuple[int, int], tuple[float, float], float]:
    """Rows and columns of the grid of scene points, `cells` per pitch, the first of them, and their spacing [px]."""
    width, height = lattice.image_size
    spacing = lattice.pitch / cells
    return (int(np.ceil(height / spacing)) + 1, int(np.ceil(width / spacing)) + 1), (-0.5, -0.5), spacing


def _steps_nearby(lattice: Lattice) -> NDArray[np.int64]:
    """(k, 2) index steps to the lenses that look at the same points, the nearest first, as the kernel sorts them."""
    span = np.arange(-3, 4)
    steps = np.stack(np.meshgrid(span, span), -1).reshape(-1, 2)
    distance = np.linalg.norm(steps @ lattice.basis, axis=1)
    return steps[np.argsort(distance, kind="stable")[: int((distance < _LOOKING * lattice.pitch).sum())]]


def densify(
    gray: GrayFlat,
    lattice: Lattice,
    values: NDArray[np.float32],
    seconds: NDArray[np.float32],
    trust: NDArray[np.float32],
    noise: float,
    cells: int,
    settled: NDArray[np.bool_] | None = None,
    before: Surface | None = None,
) -> Surface:
    """Patch size of every scene point from the patch sizes of the lenses around it.

    Where they agree the answer is their weighted mean. Where they do not, each candidate depth is
    tried on the pixels, where the better half of the views decides (an occluder hides the rest), and
    the candidates of neighbouring points support each other (semi-global matching, Hirschmueller 2008):
    first on a grid of twice the spacing, then between its values where these differ.

    Parameters
    ----------
    gray : GrayFlat
        At the flat's own resolution.
    lattice : Lattice
    values : (n,) float32 [px]
        Patch size of each lens, finite.
    seconds : (n, 2) float32 [px]
        Other patch sizes that it may show as well: the next best, and that of what the first leaves unexplained; NaN
        where there is none.
    trust : (n,) float32
        Weight of each lens, positive.
    noise : float
        Standard deviation of a pixel of `gray`.
    cells : int
        Grid values per pitch: with 7, a depth edge moves less than a traditional pixel.
    settled : (n,) bool, optional
        Lenses whose surroundings stay as in the surface `before`, if that is of the whole flat.
    """
    pitch = lattice.pitch
    shape, start, spacing = grid_shape(lattice, cells)
    grid, low = lens_grid(lattice)
    ring = cached(lattice, "looking", lambda: _steps_nearby(lattice))
    gap = np.float32(max(0.75, 0.04 * pitch))
    inverse, bend, indices = np.linalg.inv(lattice.basis), lens_displacements(lattice), lattice.indices()
    calm = find_agreeing_lenses(values, seconds, trust, indices, grid, low, ring, gap)
    old = np.empty((0, 0), np.float32)
    if before is not None and before.patch_size.shape == shape and before.first == start:
        old = before.patch_size
    if settled is None:
        old = old[:0, :0]
    table = np.empty((len(values), 6), np.float32)
    table[:, :2], table[:, 2], table[:, 3], table[:, 4:] = gray.centres, trust, values, seconds

    def settle(
        shape: tuple[int, int], part: float, old: NDArray[np.float32], coarse: NDArray[np.float32], purpose: str
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        depths, costs, totals = (
            allocate_scratch(name, (MAX_HYPOTHESES, *shape), np.float32) for name in ("depths", "costs", "totals")
        )
        around, unsettled = neighbour_rows(lattice, ring), allocate_scratch("unsettled", old.shape, np.bool_)
        if old.size:
            mark_changed_points(
                settled, gray.centres, indices, around, ring, lattice.origin, lattice.basis, inverse, *bend, start[0],
                spacing / part, unsettled,
            )  # fmt: skip
        propose_hypotheses(
            gray.image, table, around, np.float32(gray.radius), np.float32(pitch), calm, grid, low, lattice.origin,
            inverse, *bend, ring, gap, np.float32(4 * noise * noise), start[0], spacing / part,
            np.float32((_VOTING * pitch) ** 2), np.float32(max(1.0, pitch / 48)), unsettled, old, coarse, depths, costs,
        )  # fmt: skip
        chosen = allocate_scratch(purpose, shape, np.float32)
        # A step between grid values counts as part of those that it stands for, as what they mismatch does.
        _settle(depths, costs, gap, np.float32(part), totals, chosen)
        return depths, chosen

    # Only where values of twice the spacing disagree those between them are asked: along depth edges.
    half = shape[0] // 2 + 1, shape[1] // 2 + 1
    _, coarse = settle(half, 0.5, _every_other(old, half), np.empty((0, 0), np.float32), "coarse")
    depths, chosen = settle(shape, 1.0, old, coarse, "chosen")
    out = np.empty_like(chosen)
    _without_specks(chosen, depths, gap, out)
    return Surface(out, start, spacing)


def _every_other(values: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.float32]:
    """Every other row and column, with the last ones repeated to fill the `shape`; (0, 0) stays so."""
    if not values.size:
        return values
    some, out = values[::2, ::2], np.empty(shape, values.dtype)
    rows, columns = some.shape
    out[:rows, :columns], out[rows:, :columns] = some, some[-1]
    out[:, columns:] = out[:, columns - 1 : columns]
    return out
