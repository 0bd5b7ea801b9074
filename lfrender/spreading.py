"""From the depth of lenses to the depth of every scene point, edges settled on the pixels."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Lattice

from .bending import lattice_bend
from .candidates import MOST_CANDIDATES, calm_lenses, propose
from .fastmath import FAST
from .neighbours import lens_grid
from .radiance import GrayFlat
from .surface import Surface

__all__ = ["grid_shape", "spread"]

# Lenses within this many pitches vote for depths, those within the second number look at them.
_VOTING, _LOOKING = 1.45, 2.1
# Specks are smaller than about half of a square of so many grid values to each side.
_SPECK = 1
# Price of a depth edge between neighbouring grid values, and of a slant by one gap.
_JUMP, _SLANT = np.float32(0.35), np.float32(0.1)


@njit(cache=True, nogil=True, fastmath=FAST)
def _walk(depths, costs, gap, total):
    """One path of semi-global matching over the candidates of a line of scene points."""
    most = depths.shape[1]
    message = np.zeros(most, np.float32)
    previous = np.zeros(most, np.float32)
    low = np.float32(0.0)
    for p in range(len(depths)):
        lowest = np.float32(np.inf)
        for k in range(most):
            s = depths[p, k]
            # Candidates come first, unused places after them.
            if np.isnan(s):
                for q in range(k, most):
                    message[q] = np.inf
                break
            best = np.float32(0.0)
            if p > 0:
                best = _JUMP
                for q in range(most):
                    t = depths[p - 1, q]
                    if np.isnan(t):
                        break
                    apart = abs(s - t) / gap
                    best = min(best, previous[q] - low + min(_JUMP, _SLANT * apart if apart < 1 else _JUMP))
            message[k] = costs[p, k] + best
            total[p, k] += message[k]
            lowest = min(lowest, message[k])
        low = lowest
        for k in range(most):
            previous[k] = message[k]


@njit(cache=True, nogil=True, parallel=True)
def _settle(depths, costs, gap, out):
    """Choose one candidate per scene point with the support of its row and column, both ways."""
    rows, columns, most = depths.shape
    total = np.zeros_like(costs)
    # A line on which no point has two candidates has nothing to settle.
    across, down = np.zeros(rows, np.bool_), np.zeros(columns, np.bool_)
    for v in range(rows):
        for u in range(columns):
            if not np.isnan(depths[v, u, 1]):
                across[v] = down[u] = True
    for v in prange(rows):
        if not across[v]:
            continue
        _walk(depths[v], costs[v], gap, total[v])
        _walk(depths[v, ::-1], costs[v, ::-1], gap, total[v, ::-1])
    for u in prange(columns):
        if not down[u]:
            continue
        _walk(depths[:, u], costs[:, u], gap, total[:, u])
        _walk(depths[::-1, u], costs[::-1, u], gap, total[::-1, u])
    for v in prange(rows):
        for u in range(columns):
            best = 0
            for k in range(1, most):
                if not np.isnan(depths[v, u, k]) and total[v, u, k] < total[v, u, best]:
                    best = k
            out[v, u] = depths[v, u, best]


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
            if np.isnan(depths[v, u, 1]):
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


def _nearest_is(
    mask: NDArray[np.bool_],
    lattice: Lattice,
    grid: NDArray[np.int32],
    low: NDArray[np.int64],
    shape: tuple[int, int],
    first: float,
    spacing: float,
) -> NDArray[np.bool_]:
    """(h, w) bool: grid values whose lattice cell belongs to a lens of `mask` (n,)."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    index = np.rint(lattice.to_index(first + spacing * np.stack([u.ravel(), v.ravel()], 1))).astype(int) - low
    i, j = index.T
    inside = (i >= 0) & (j >= 0) & (i < grid.shape[1]) & (j < grid.shape[0])
    lens = np.where(inside, grid[np.where(inside, j, 0), np.where(inside, i, 0)], -1)
    return ((lens >= 0) & mask[lens]).reshape(shape)


def spread(
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
    the candidates of neighbouring points support each other (semi-global matching, Hirschmueller 2008).

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
    depths = np.empty((*shape, MOST_CANDIDATES), np.float32)
    costs = np.empty_like(depths)
    grid, low = lens_grid(lattice)
    span = np.arange(-3, 4)
    ring = np.stack(np.meshgrid(span, span), -1).reshape(-1, 2)
    distance = np.linalg.norm(ring @ lattice.basis, axis=1)
    # The nearest first, as the kernel sorts them for each scene point.
    ring = ring[np.argsort(distance, kind="stable")[: int((distance < _LOOKING * pitch).sum())]]
    gap = np.float32(max(0.75, 0.04 * pitch))
    calm = calm_lenses(values, seconds, trust, lattice.indices(), grid, low, ring, gap)
    kept = settled is not None and before is not None and before.patch_size.shape == shape and before.first == start
    if settled is not None and kept:
        calm[settled & (calm == 0)] = 1
    propose(
        gray.image, gray.centres, np.float32(gray.radius), np.float32(pitch), values, seconds, trust, calm, grid, low,
        lattice.origin, np.linalg.inv(lattice.basis), *lattice_bend(lattice), ring, gap, np.float32(4 * noise * noise),
        start[0], spacing, np.float32((_VOTING * pitch) ** 2), np.float32(max(1.0, pitch / 48)), depths, costs,
    )  # fmt: skip
    chosen = np.empty(shape, np.float32)
    _settle(depths, costs, gap, chosen)
    out = np.empty_like(chosen)
    _without_specks(chosen, depths, gap, out)
    if settled is not None and before is not None and kept:
        there = _nearest_is(settled, lattice, grid, low, shape, start[0], spacing)
        out[there] = before.patch_size[there]
    return Surface(out, start, spacing)
