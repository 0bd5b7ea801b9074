"""Thin structures before a far surface, propagated from lens to lens.

Microimages that are shifted by half a pitch share only their rims: at that depth no neighbour confirms the middle of a
lens, so that a branch there does not show as a second layer either. But a branch runs on: at the depth that one lens
has for it, the next one shows a few pixels that its neighbours confirm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST
from lfcal.runtime.kernels.jit import kernel

from ...flat.gray_flat import downsample
from ...flat.lens_graph import join_opposite
from ...flat.texture import Texture
from ..refinement.pair_pixels import flat_pixels
from ..refinement.settings import REFINEMENT
from ..same_surface import same_surface
from .settings import SURFACE, SurfaceSettings
from .window_differences import BORDER, FEWEST, copy_windows, count_views, inner_columns, new_windows, set_limits

__all__ = ["find_thin_structures"]

# Rounded patch sizes of one lens are below this number; with the row of the lens they form one key.
_KEYS = 1 << 20
# Columns of the known patch sizes of each lens.
_FIRST, _LAYER, _FOUND, _SECOND = range(4)


@kernel(fastmath=FAST, error_model="numpy", share=lambda *given: len(given[5]))
def _measure_shares(begin, end, image, centres, radius, pitch, rows, lenses, sizes, firsts, floor, out):
    """Share of the pixels of some `lenses` (m,) that half of their neighbours confirm at `sizes`, and not at `firsts`
    (m,); 0 where these are too few."""
    flat, windows = flat_pixels(image), new_windows(radius)
    stride, height, width = windows.stride, image.shape[0], image.shape[1]
    here, limits = np.empty(stride * stride, np.bool_), windows.limits
    for task in range(begin, end):
        lens = lenses[task]
        ax, ay = centres[lens, 0], centres[lens, 1]
        copy_windows(flat, ax, ay, windows)
        set_limits(windows, 1, 1, floor)
        left, top, total, count = windows.corner[0], windows.corner[1], 0, 0
        seen = count_views(flat, windows, centres, lens, radius, sizes[task], pitch, rows, 1, 1)
        for k in range((stride - 2) * stride):
            here[k] = 2 * windows.confirming[k] >= seen
        count_views(flat, windows, centres, lens, radius, firsts[task], pitch, rows, 1, 1)
        for v in range(1, stride - 1):
            first, last = inner_columns(top + v, ax, ay, radius, height, width)
            total += max(last - first + 1, 0)
            for x in range(first, last + 1):
                at = (v - 1) * stride + x - left
                # Windows without texture are confirmed anywhere.
                textured = limits[at] >= 18 * floor
                count += int(textured and here[at] and 2 * windows.confirming[at] < seen)
        out[task] = count / total if count >= FEWEST else 0.0


def _depth_order(sizes: NDArray[np.float32], pitch: float) -> NDArray[np.float32]:
    """As `depth_order`, of many."""
    return np.where(sizes > 0, sizes, sizes + 2 * pitch)


def _new_hypotheses(
    known: NDArray[np.float32], rows: NDArray[np.int32], lenses: NDArray[np.int64], gap: float, pitch: float
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Patch sizes [px] of neighbours that some `lenses` (m,) do not have, before their first one: lenses, and sizes.

    The second-best match of a lens counts as one it does not have: confirmed by a neighbour it is no false match.
    """
    beside = rows[lenses]
    others = np.where((beside >= 0)[:, :, None], known[beside], np.nan).reshape(len(lenses), -1)
    own = known[lenses][:, None, [_FIRST, _LAYER, _FOUND]]
    new = ~same_surface(others[:, :, None], own, gap).any(2)
    at, which = np.nonzero(new & (_depth_order(others, pitch) > _depth_order(known[lenses, _FIRST, None], pitch)))
    return lenses[at], others[at, which]


def _best_of_each(lens: NDArray[np.int64], share: NDArray[np.float32]) -> NDArray[np.int64]:
    """Where each of the lenses has its largest share, of those that have any."""
    order = np.lexsort((share, lens))
    order = order[share[order] > 0]
    last = np.ones(len(order), bool)
    last[:-1] = np.diff(lens[order]) > 0
    return order[last]


def find_thin_structures(
    texture: Texture,
    forward: NDArray[np.int32],
    backward: NDArray[np.int32],
    first: NDArray[np.float32],
    others: NDArray[np.float32],
    wanted: NDArray[np.bool_],
    gap: float,
    settings: SurfaceSettings = SURFACE,
) -> NDArray[np.float32]:
    """Patch sizes of thin structures that lenses show before their first surface, propagated from their neighbours.

    Parameters
    ----------
    texture : Texture
    forward, backward : (n, d) int32
        Neighbour rows in `d` directions and in their opposites, -1 where there is none.
    first : (n,) float32 [px]
        Finite.
    others : (n, 2) float32 [px]
        Second-best patch size of each lens, and that of its second layer; NaN where there is none.
    wanted : (n,) bool
        The other lenses are left out.
    gap : float [px]
        Patch sizes that differ by less belong to one surface.
    settings : SurfaceSettings

    Returns
    -------
    (n,) float32 [px]
        NaN where there is no such structure, or where a neighbour has that patch size as its first.
    """
    pitch = texture.flat.pitch
    wanted = wanted & (texture.clear | texture.faint) & (np.abs(first) > REFINEMENT.far_patch_size * pitch)
    rows = join_opposite(forward, backward)
    if not wanted.any():
        return np.full(len(first), np.nan, np.float32)
    factor = max(1, round(pitch / settings.pitch))
    gray, noise = downsample(texture.flat, factor), texture.noise / factor

    def confirmed(lenses: NDArray[np.int64], sizes: NDArray[np.float32]) -> NDArray[np.float32]:
        out = np.empty(len(lenses), np.float32)
        _measure_shares(
            gray.image, gray.centres, np.float32(gray.radius - BORDER), np.float32(gray.pitch), rows, lenses,
            sizes / np.float32(factor), (first[lenses] / factor).astype(np.float32), np.float32(4 * noise * noise), out,
        )  # fmt: skip
        return out

    # A second-best patch size is false in every fourth lens: only confirmed ones are propagated.
    second = np.flatnonzero(wanted & np.isfinite(others[:, 0]))
    sure = second[confirmed(second, others[second, 0]) > 0]
    known = np.full((len(first), 4), np.nan, np.float32)
    known[:, _FIRST], known[:, _LAYER], known[sure, _SECOND] = first, others[:, 1], others[sure, 0]
    found = known[:, _FOUND]
    fresh, tried = np.ones(len(first), bool), np.empty(0, np.int64)
    while True:
        lenses = np.flatnonzero(wanted & np.isnan(found) & ((rows >= 0) & fresh[rows]).any(1))
        if not len(lenses):
            break
        lens, size = _new_hypotheses(known, rows, lenses, gap, pitch)
        keys, once = np.unique(lens * _KEYS + np.rint(size / gap).astype(np.int64), return_index=True)
        once = once[~np.isin(keys, tried)]
        lens, size, tried = lens[once], size[once], np.union1d(tried, keys)
        best = _best_of_each(lens, confirmed(lens, size))
        found[lens[best]] = size[best]
        fresh[:] = False
        fresh[lens[best]] = True
    # The first patch size of a neighbour is a hypothesis for the points about this lens in any case.
    redundant = same_surface(np.where(rows >= 0, first[rows], np.nan), found[:, None], gap).any(1)
    return np.where(redundant, np.nan, found).astype(np.float32)
