"""What each microimage pixel sees: the surface projected into every lens, with a depth buffer.

Only lenses with a depth edge in reach are projected; in all others each pixel sees the one surface that is there.
"""

from __future__ import annotations

from dataclasses import dataclass
from threading import local

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal import Lattice
from lfcal.runtime.fastmath import FAST, square
from lfcal.runtime.kernels.jit import kernel

from ...data.surface import Surface, mark_changed_places
from ...depth.depth_order import depth_order
from ...runtime.buffers import allocate_scratch

__all__ = ["project_surface"]

# Lattice, reach, tolerance and part of a projection: if all are the same, only changed lenses are projected again.
_Geometry = tuple[Lattice, float, float, tuple[int, int, int, int] | None]

# Side of the squares of grid values whose range is computed first: without an edge in these, values are not read.
_SQUARE = 4
# Left free at each side between two microimages [px]: more than rounding of their centres.
_GAP = 0.01
# Height of the bands of a flat that threads work on [pitches].
_BAND = 2


@kernel(error_model="numpy", fastmath=FAST, share=lambda surface, lows, highs: len(lows))
def _compute_ranges(begin, end, surface, lows, highs):
    """Fill `lows` and `highs` with the least and largest value of each square of the surface."""
    for v in range(begin, end):
        for u in range(lows.shape[1]):
            square = surface[v * _SQUARE : (v + 1) * _SQUARE, u * _SQUARE : (u + 1) * _SQUARE]
            low = high = square[0, 0]
            for y in range(square.shape[0]):
                for x in range(square.shape[1]):
                    low, high = min(low, square[y, x]), max(high, square[y, x])
            lows[v, u], highs[v, u] = low, high


@njit(fastmath=FAST)
def _is_smooth(lows, highs, low_v, high_v, low_u, high_u, edge):
    """Whether the values of all squares that hold these rows and columns differ by less than an `edge`."""
    low, high = np.float32(np.inf), np.float32(-np.inf)
    for v in range(low_v // _SQUARE, high_v // _SQUARE + 1):
        for u in range(low_u // _SQUARE, high_u // _SQUARE + 1):
            low, high = min(low, lows[v, u]), max(high, highs[v, u])
    return high - low < edge


@njit(fastmath=FAST)
def _project(
    surface, lows, highs, first_x, first_y, spacing, centres, lenses, radius, pitch, reach, edge, corner, edged, out
):  # fmt: skip
    """Set `out` to the depth that pixels of some `lenses` see, and `edged` if these have a depth edge in reach."""
    rows, columns = surface.shape
    left, top = corner
    right, bottom = left + out.shape[1], top + out.shape[0]
    per_pitch = np.float32(1.0) / pitch
    for lens in lenses:
        cx, cy = centres[lens, 0], centres[lens, 1]
        low_u = max(0, int(np.ceil((cx - reach - first_x) / spacing)))
        high_u = min(columns - 1, int(np.floor((cx + reach - first_x) / spacing)))
        low_v = max(0, int(np.ceil((cy - reach - first_y) / spacing)))
        high_v = min(rows - 1, int(np.floor((cy + reach - first_y) / spacing)))
        if _is_smooth(lows, highs, low_v, high_v, low_u, high_u, edge):
            edged[lens] = False
            continue
        lowest = highest = surface[min(low_v, rows - 1), min(low_u, columns - 1)]
        farthest = depth_order(lowest, pitch)
        for v in range(low_v, high_v + 1):
            for u in range(low_u, high_u + 1):
                lowest = min(lowest, surface[v, u])
                highest = max(highest, surface[v, u])
                farthest = min(farthest, depth_order(surface[v, u], pitch))
        edged[lens] = highest - lowest >= edge
        if not edged[lens]:
            continue
        for v in range(low_v, high_v + 1):
            across_y = np.float32(first_y + v * spacing - cy)
            for u in range(low_u, high_u + 1):
                s = surface[v, u]
                near = depth_order(s, pitch)
                # The farthest surface occludes nothing.
                if near <= farthest + edge:
                    continue
                tilt = s * per_pitch
                dx, dy = -np.float32(first_x + u * spacing - cx) * tilt, -across_y * tilt
                # The grid value covers a square of this size in the microimage.
                half = np.float32(0.5) * abs(tilt) * spacing + np.float32(0.25)
                if dx * dx + dy * dy > square(radius + half):
                    continue
                for y in range(int(np.ceil(cy + dy - half)), int(np.floor(cy + dy + half)) + 1):
                    for x in range(int(np.ceil(cx + dx - half)), int(np.floor(cx + dx + half)) + 1):
                        if x < left or y < top or x >= right or y >= bottom:
                            continue
                        if (x - cx) * (x - cx) + (y - cy) * (y - cy) > radius * radius:
                            continue
                        # True for NaN as well: nothing was projected to this pixel yet.
                        if not depth_order(out[y - top, x - left], pitch) >= near:
                            out[y - top, x - left] = s


@njit(fastmath=FAST)
def _erase(centres, lenses, radius, corner, edged, out):
    """Set the pixels of lenses that were `edged` to NaN."""
    left, top = corner
    for lens in lenses:
        if not edged[lens]:
            continue
        cx, cy = centres[lens, 0], centres[lens, 1]
        first, end = max(int(np.ceil(cx - radius)), left), min(int(np.floor(cx + radius)) + 1, left + out.shape[1])
        for y in range(max(int(np.ceil(cy - radius)), top), min(int(np.floor(cy + radius)) + 1, top + out.shape[0])):
            for x in range(first, end):
                if (x - cx) * (x - cx) + (y - cy) * (y - cy) <= radius * radius:
                    out[y - top, x - left] = np.nan


@kernel(error_model="numpy", share=lambda *given: len(given[5]))
def _project_bands(
    begin, end, surface, ranges, place, centres, order, ends, radius, pitch, reach, edge, corner, fresh, edged, out
):  # fmt: skip
    """Project the surface into the lenses of some bands; unless `out` is `fresh`, they are erased first."""
    lows, highs = ranges
    first_x, first_y, spacing = place
    for band in range(begin, end):
        lenses = order[ends[band - 1] if band else 0 : ends[band]]
        if not fresh:
            _erase(centres, lenses, radius, corner, edged, out)
        _project(
            surface, lows, highs, first_x, first_y, spacing, centres, lenses, radius, pitch, reach, edge, corner, edged,
            out,
        )  # fmt: skip


def _sort_into_bands(
    rows: NDArray[np.float32], chosen: NDArray[np.int64], tall: int, bands: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The `chosen` lenses sorted by bands of `tall` pixel rows, and the places after the last of each band."""
    band = np.clip((rows[chosen] / tall).astype(np.int64), 0, bands - 1)
    return chosen[np.argsort(band, kind="stable")], np.cumsum(np.bincount(band, minlength=bands))


def _project_chosen(
    surface: Surface,
    lattice: Lattice,
    centres: NDArray[np.float32],
    limits: tuple[float, float, float],
    corner: tuple[int, int],
    chosen: NDArray[np.int64],
    fresh: bool,
    edged: NDArray[np.bool_],
    out: NDArray[np.float32],
) -> None:
    """Project the surface into the lenses of rows `chosen` (m,); a `fresh` output is filled with NaN first.

    The `limits` are the radius of lenses, and `reach` and `edge` of `project_surface`.
    """
    if not out.size:
        return
    if fresh:
        out.fill(np.nan)
    values = surface.patch_size
    ranges = tuple(np.empty((-(-values.shape[0] // _SQUARE), -(-values.shape[1] // _SQUARE)), np.float32) for _ in "lh")
    _compute_ranges(values, *ranges)
    # Bands stay in the cache of their thread.
    tall = max(int(_BAND * lattice.pitch), 1)
    bands = -(-out.shape[0] // tall)
    order, ends = _sort_into_bands(centres[:, 1] - corner[1], chosen, tall, bands)
    radius, reach, edge = map(np.float32, limits)
    place = np.float32(surface.first[0]), np.float32(surface.first[1]), np.float32(surface.spacing)
    pitch = np.float32(lattice.pitch)
    _project_bands(
        values, ranges, place, centres, order, ends, radius, pitch, reach, edge, corner, fresh, edged, out
    )  # fmt: skip


def project_surface(
    surface: Surface,
    lattice: Lattice,
    reach: float,
    edge: float,
    part: tuple[int, int, int, int] | None = None,
    edged: NDArray[np.bool_] | None = None,
    purpose: str | None = None,
    incremental: bool = False,
) -> NDArray[np.float32]:
    """(H, W) float32 [px]: patch size of the surface that each flat pixel sees through its lens.

    NaN where that is unknown, or occludes nothing: around lenses with no depth edge in reach, and on the farthest
    surface that a lens shows.

    Parameters
    ----------
    surface : Surface
    lattice : Lattice
    reach : float [px]
        Scene points farther than this from a lens are not projected into it.
    edge : float [px]
        Patch sizes that differ by less belong to one surface.
    part : (left, top, right, bottom) [px], optional
        Only these pixels of the flat.
    edged : (n,) bool, optional
        Set to whether lenses have a depth edge in reach, False for those that have no such pixel.
    purpose : str, optional
        The result lies in `allocate_scratch` memory for this.
    incremental : bool
        Update the last result for that purpose, into which nobody has written, if only the surface differs.
    """
    left, top, right, bottom = part or (0, 0, *lattice.image_size)
    shape = (bottom - top, right - left)
    out = np.empty(shape, np.float32) if purpose is None else allocate_scratch(purpose, shape, np.float32)
    # No two lenses share a pixel, unless the lattice is distorted.
    radius = min(lattice.radius, float(np.linalg.norm(lattice.steps @ lattice.basis, axis=1).min()) / 2 - _GAP)
    centres = lattice.centres()
    inside: NDArray[np.bool_] = np.ones(len(centres), bool)
    if part is not None:
        near = np.array([left, top]) - radius - 1, np.array([right, bottom]) + radius + 1
        inside = np.asarray(((centres >= near[0]) & (centres <= near[1])).all(1))
        centres = centres[inside]
    places = centres.astype(np.float32)
    geometry = lattice, reach, edge, part
    before = None if purpose is None else _last.__dict__.pop(purpose, None)
    if before is None or not incremental or not before.can_update(surface, geometry, out):
        chosen, fresh, found = np.arange(len(places)), True, np.empty(len(places), bool)
    else:
        differs = np.zeros(len(places), bool)
        mark_changed_places(before.surface, surface, centres, reach + surface.spacing, differs)
        chosen, fresh, found = np.flatnonzero(differs), False, before.edged
    _project_chosen(surface, lattice, places, (radius, reach, edge), (left, top), chosen, fresh, found, out)
    # Lenses that share pixels cannot be erased one by one; an array that is no view is not scratch memory.
    if purpose is not None and out.base is not None and lattice.distortion is None:
        setattr(_last, purpose, _Projection(surface, geometry, found, out))
    if edged is not None:
        edged[:] = False
        edged[inside] = found
    return out


@dataclass(frozen=True)
class _Projection:
    """The last projection into some scratch memory."""

    surface: Surface
    geometry: _Geometry
    edged: NDArray[np.bool_]
    out: NDArray[np.float32]

    def can_update(self, surface: Surface, geometry: _Geometry, out: NDArray[np.float32]) -> bool:
        """Whether only the values of the surface differ."""
        grids = [(of.patch_size.shape, of.first, of.spacing) for of in (self.surface, surface)]
        memory = [(of.ctypes.data, of.shape) for of in (self.out, out)]
        same = geometry[0] is self.geometry[0] and geometry[1:] == self.geometry[1:]
        return same and grids[0] == grids[1] and memory[0] == memory[1]


# By purpose; frames may be rendered in several threads at once.
_last = local()
