"""The depth of every scene point: lens answers spread over the picture, edges settled on the pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal import Lattice

from .neighbours import lens_grid
from .radiance import GrayFlat

__all__ = ["Surface", "spread"]

# Grid values per pitch: fine enough that a depth edge moves less than a traditional pixel.
_CELLS_PER_PITCH = 8
# Half width of the patch on which candidate depths compete, in samples, and their distance in pitches.
_PATCH = 2
_PATCH_STEP = 1 / 24


@dataclass(frozen=True)
class Surface:
    """Signed patch size on a regular grid of scene points.

    Parameters
    ----------
    patch_size : (h, w) float32 [px]
        Finite everywhere.
    first : (float, float) [px]
        Scene coordinates of grid value `[0, 0]`, order `x, y`.
    spacing : float [px]
        Distance between grid values in scene coordinates.
    """

    patch_size: NDArray[np.float32]
    first: tuple[float, float]
    spacing: float


@njit(cache=True, nogil=True, fastmath=True, inline="always")
def _sample(image, x, y):
    height, width = image.shape
    x = min(max(x, np.float32(0.0)), np.float32(width - 1.001))
    y = min(max(y, np.float32(0.0)), np.float32(height - 1.001))
    i, j = int(x), int(y)
    fx, fy = x - i, y - j
    return (1 - fy) * ((1 - fx) * image[j, i] + fx * image[j, i + 1]) + fy * (
        (1 - fx) * image[j + 1, i] + fx * image[j + 1, i + 1]
    )


@njit(cache=True, nogil=True, fastmath=True)
def _mismatch(image, centres, members, count, x, y, slope, radius, step, floor):
    """How badly the nearest lens and the better half of its neighbours agree on the patch at (x, y)."""
    side = 2 * _PATCH + 1
    patch = np.empty(side * side, np.float32)
    first = members[0]
    px = centres[first, 0] - (x - centres[first, 0]) * slope
    py = centres[first, 1] - (y - centres[first, 1]) * slope
    mean_a = squares_a = np.float32(0.0)
    for k in range(side * side):
        patch[k] = _sample(image, px + (k % side - _PATCH) * step, py + (k // side - _PATCH) * step)
        mean_a += patch[k]
        squares_a += patch[k] * patch[k]
    mean_a /= side * side
    variance_a = max(squares_a / (side * side) - mean_a * mean_a, np.float32(0.0))
    costs = np.empty(len(members), np.float32)
    found = 0
    for m in range(1, count):
        lens = members[m]
        dx = -(x - centres[lens, 0]) * slope
        dy = -(y - centres[lens, 1]) * slope
        if dx * dx + dy * dy > radius * radius:
            continue
        qx, qy = centres[lens, 0] + dx, centres[lens, 1] + dy
        sb = sbb = sdd = np.float32(0.0)
        for k in range(side * side):
            b = _sample(image, qx + (k % side - _PATCH) * step, qy + (k // side - _PATCH) * step)
            sb += b
            sbb += b * b
            sdd += (b - patch[k]) * (b - patch[k])
        mean_b = sb / (side * side)
        variance_b = max(sbb / (side * side) - mean_b * mean_b, np.float32(0.0))
        cost = (sdd / (side * side) + floor) / (variance_a + variance_b + (mean_a - mean_b) ** 2 + floor)
        # insertion keeps the costs sorted
        at = found
        while at > 0 and costs[at - 1] > cost:
            costs[at] = costs[at - 1]
            at -= 1
        costs[at] = cost
        found += 1
    if found == 0:
        return np.float32(1.0)
    best = np.float32(0.0)
    half = (found + 1) // 2
    for m in range(half):
        best += costs[m]
    return best / half


@njit(cache=True, nogil=True, parallel=True, fastmath=True)
def _spread(
    image, centres, radius, pitch, values, trust, grid, low, origin, inverse, basis, ring, gap, floor,
    first, spacing, prior, out, contested,
):  # fmt: skip
    rows, columns = out.shape
    nearby = len(ring)
    for v in prange(rows):
        members = np.empty(nearby, np.int32)
        order = np.empty(nearby, np.int32)
        distance = np.empty(nearby, np.float32)
        for u in range(columns):
            x, y = first[0] + u * spacing, first[1] + v * spacing
            ox, oy = x - origin[0], y - origin[1]
            i = int(np.rint(ox * inverse[0, 0] + oy * inverse[1, 0]))
            j = int(np.rint(ox * inverse[0, 1] + oy * inverse[1, 1]))
            count = 0
            for r in range(nearby):
                ci, cj = i + ring[r, 0] - low[0], j + ring[r, 1] - low[1]
                if ci < 0 or cj < 0 or cj >= grid.shape[0] or ci >= grid.shape[1]:
                    continue
                lens = grid[cj, ci]
                if lens < 0:
                    continue
                d = np.float32((x - centres[lens, 0]) ** 2 + (y - centres[lens, 1]) ** 2)
                at = count
                while at > 0 and distance[at - 1] > d:
                    distance[at], members[at] = distance[at - 1], members[at - 1]
                    at -= 1
                distance[at], members[at] = d, lens
                count += 1
            if count == 0:
                out[v, u] = np.nan
                continue
            voters = 0
            for m in range(count):
                if distance[m] < 1.4 * pitch * pitch or m == 0:
                    at = voters
                    while at > 0 and values[members[order[at - 1]]] > values[members[m]]:
                        order[at] = order[at - 1]
                        at -= 1
                    order[at] = m
                    voters += 1
            clusters = 1
            for m in range(1, voters):
                if values[members[order[m]]] - values[members[order[m - 1]]] > gap:
                    clusters += 1
            contested[v, u] = clusters > 1
            everyone = np.float32(0.0)
            for m in range(voters):
                everyone += trust[members[order[m]]] * np.exp(-3 * distance[order[m]] / (pitch * pitch))
            best = np.float32(np.inf)
            start = 0
            while start < voters:
                stop = start + 1
                while stop < voters and values[members[order[stop]]] - values[members[order[stop - 1]]] <= gap:
                    stop += 1
                weight = total = np.float32(0.0)
                for m in range(start, stop):
                    lens = members[order[m]]
                    w = trust[lens] * np.exp(-3 * distance[order[m]] / (pitch * pitch))
                    weight += w
                    total += w * values[lens]
                s = total / weight
                cost = np.float32(0.0)
                if clusters > 1:
                    cost = _mismatch(
                        image, centres, members, count, np.float32(x), np.float32(y), s / pitch, radius,
                        max(np.float32(1.0), np.float32(pitch * _PATCH_STEP)), floor,
                    ) + prior * (1 - weight / everyone)  # fmt: skip
                if cost < best:
                    best = cost
                    out[v, u] = s
                start = stop


def spread(
    gray: GrayFlat, lattice: Lattice, values: NDArray[np.float32], trust: NDArray[np.float32], noise: float
) -> Surface:
    """Patch size of every scene point from the patch sizes of the lenses around it.

    Where they agree the answer is their weighted mean; where they do not, each candidate depth
    is tried on the pixels, and the better half of the views decides (an occluder hides the rest).

    Parameters
    ----------
    gray : GrayFlat
        At the flat's own resolution.
    lattice : Lattice
    values : (n,) float32 [px]
        Patch size of each lens, finite.
    trust : (n,) float32
        Weight of each lens, positive.
    noise : float
        Standard deviation of a pixel of `gray`.
    """
    import cv2

    width, height = lattice.image_size
    spacing = lattice.pitch / _CELLS_PER_PITCH
    shape = (int(np.ceil(height / spacing)) + 1, int(np.ceil(width / spacing)) + 1)
    out = np.empty(shape, np.float32)
    contested = np.empty(shape, np.bool_)
    grid, low = lens_grid(lattice)
    span = np.arange(-2, 3)
    ring = np.stack(np.meshgrid(span, span), -1).reshape(-1, 2)
    ring = ring[np.linalg.norm(ring @ lattice.basis, axis=1) < 2.1 * lattice.pitch]
    _spread(
        gray.image, gray.centres, np.float32(gray.radius), np.float32(lattice.pitch), values, trust, grid, low,
        lattice.origin, np.linalg.inv(lattice.basis), lattice.basis, ring,
        np.float32(max(0.75, 0.04 * lattice.pitch)), np.float32(2 * noise * noise),
        np.array([-0.5, -0.5]), spacing, np.float32(0.15), out, contested,
    )  # fmt: skip
    smooth = cv2.medianBlur(cv2.medianBlur(out, 5), 5)
    return Surface(np.where(contested, smooth, out), (-0.5, -0.5), spacing)
