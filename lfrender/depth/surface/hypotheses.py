"""Depth hypotheses of each scene point, from the lenses around it, and the mismatch of each on the pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST

from ...runtime.scheduling import coprime_stride
from ..same_surface import same_surface
from .occlusion import depth_order
from .photoconsistency import (
    MAX_VIEWS,
    WORK,
    PatchViews,
    ViewConstants,
    sample_views,
    view_mismatch,
)
from .scene_grid import SceneGrid, lens_at, nearest_lens
from .settings import HypothesisSettings

__all__ = ["MAX_HYPOTHESES", "find_agreeing_lenses", "hypothesis_constants", "propose_hypotheses"]

_DEFAULT = HypothesisSettings()
#: Hypotheses of one scene point, at most.
MAX_HYPOTHESES = 5
# Rows of what is known of each lens: its centre, its weight, and from the last one on its depths.
_X, _Y, _TRUST, _SIZE = 0, 1, 2, 3
# Marks lenses without a trusted one about them: any depth will do.
_ALONE = np.int8(2)


class HypothesisConstants(NamedTuple):
    """Float32 values of `HypothesisSettings`, the tolerance of one surface, the pitch [px], the squared distance within
    which lenses vote [px^2], and from the last but six on those of `ViewConstants`."""

    occluded_cost: np.float32
    matched: np.float32
    widest: np.float32
    unvoted_cost: np.float32
    rough: np.float32
    nudge: np.float32
    nudge_cost: np.float32
    good: np.float32
    second_weight: np.float32
    trusted: np.float32
    gap: np.float32
    pitch: np.float32
    vote2: np.float32
    visible_share: np.float32
    occluded_share: np.float32
    unknown: np.float32
    occluded_views: np.float32
    radius: np.float32
    step: np.float32
    floor: np.float32


class _Nearby(NamedTuple):
    """Memory of one thread for the lenses around a scene point: their `table` (6, k), squared distances, voters with
    their weights, indices of the most central ones, and votes sorted by patch size with their weights."""

    table: NDArray[np.float32]
    distance: NDArray[np.float32]
    voters: NDArray[np.int64]
    shares: NDArray[np.float32]
    central: NDArray[np.int64]
    sizes: NDArray[np.float32]
    weights: NDArray[np.float32]


class _Hypotheses(NamedTuple):
    """Memory of one thread for the hypotheses of a point: depths, first weights and then costs, matches, and views."""

    depths: NDArray[np.float32]
    costs: NDArray[np.float32]
    matches: NDArray[np.float32]
    seen: NDArray[np.int64]


def hypothesis_constants(
    gap: np.float32,
    pitch: float,
    voting_reach: float,
    views: ViewConstants,
    settings: HypothesisSettings = _DEFAULT,
) -> HypothesisConstants:
    """Values for `propose_hypotheses`: tolerance of one surface, pitch, and distance within which lenses vote [px]."""
    named = [np.float32(getattr(settings, name)) for name in HypothesisConstants._fields[:10]]
    return HypothesisConstants._make((*named, gap, np.float32(pitch), np.float32(voting_reach**2), *views))


@njit(cache=True, nogil=True, error_model="numpy")
def _add_occlusion(count, hypotheses, c):
    """Raise the cost of each hypothesis by how well a nearer one matches: past the edge of the nearer surface the one
    behind it matches as well."""
    depths, costs, matches = hypotheses.depths, hypotheses.costs, hypotheses.matches
    for k in range(count):
        matches[k] = max(c.matched - costs[k], np.float32(0.0))
    for k in range(count):
        nearer = np.float32(0.0)
        for q in range(count):
            if depth_order(depths[q], c.pitch) > depth_order(depths[k], c.pitch):
                nearer = max(nearer, matches[q])
        costs[k] += c.occluded_cost * nearer


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def find_agreeing_lenses(values, seconds, trust, indices, grid: SceneGrid, ring, gap, trusted):
    """(n,) int8: 1 for lenses that agree to one `gap` with all trusted lenses of `ring`, which have no second depths.

    2 where none of them is trusted, nor the lens itself; 0 elsewhere.
    """
    agreeing = np.empty(len(values), np.int8)
    for lens in prange(len(values)):
        lowest = highest = values[lens]
        single, alone = True, trust[lens] < trusted
        for r in range(len(ring)):
            other = lens_at(grid, indices[lens, 0] + ring[r, 0], indices[lens, 1] + ring[r, 1])
            if other < 0 or trust[other] < trusted:
                continue
            alone = False
            lowest = min(lowest, values[other])
            highest = max(highest, values[other])
            for m in range(seconds.shape[1]):
                single = single and not np.isfinite(seconds[other, m])
        agreeing[lens] = _ALONE if alone else single and highest - lowest <= gap
    return agreeing


@njit(cache=True, nogil=True, error_model="numpy")
def _interpolate_row(coarse, v, gap, values, differ):
    """Row `v` of a grid from one of twice the spacing: means of the `coarse` values about each point, in `values`, and
    whether those differ by more than a `gap`, in `differ`; both have two places for each column of `coarse`."""
    columns = coarse.shape[1]
    above, below = coarse[v // 2], coarse[(v + 1) // 2]
    first, last = coarse[max(v - 1, 0) // 2], coarse[min((v + 2) // 2, len(coarse) - 1)]
    quarter, half = np.float32(0.25), np.float32(0.5)
    low, high = np.empty(columns, np.float32), np.empty(columns, np.float32)
    for x in range(columns):
        low[x] = min(min(first[x], last[x]), above[x])
        high[x] = max(max(first[x], last[x]), above[x])
    for x in range(columns):
        values[2 * x] = half * (above[x] + below[x])
        left, right = max(x - 1, 0), min(x + 1, columns - 1)
        values[2 * x + 1] = quarter * ((above[x] + above[right]) + (below[x] + below[right]))
        lowest, highest = min(low[x], low[right]), max(high[x], high[right])
        # Beyond the flat the coarse grid may reach where no lens looks.
        differ[2 * x + 1] = highest - lowest > gap or np.isnan(values[2 * x + 1])
        differ[2 * x] = max(highest, high[left]) - min(lowest, low[left]) > gap or np.isnan(values[2 * x])


@njit(cache=True, nogil=True, error_model="numpy")
def _keep_coarse(coarse, v, u, gap, depths, weights, count):
    """Keep those of `count` hypotheses that a value of twice the spacing about point (v, u) has; all if none has."""
    kept = 0
    for k in range(count):
        near = False
        for y in range(max(v - 1, 0) // 2, min((v + 2) // 2, len(coarse) - 1) + 1):
            for x in range(max(u - 1, 0) // 2, min((u + 2) // 2, coarse.shape[1] - 1) + 1):
                near = near or same_surface(coarse[y, x], depths[k], gap)
        if near:
            depths[kept], weights[kept] = depths[k], weights[k]
            kept += 1
    return kept if kept else count


@njit(cache=True, nogil=True, error_model="numpy")
def _gather_table(table, rows, grid, ring, i, j, lens, out):
    """Copy the `table` of the lenses around lens (i, j) to columns of `out`; returns how many there are."""
    count = 0
    for r in range(len(ring)):
        other = rows[lens, r] if lens >= 0 else lens_at(grid, i + ring[r, 0], j + ring[r, 1])
        if other >= 0:
            for k in range(len(out)):
                out[k, count] = table[other, k]
            count += 1
    return count


# Python's error model checks every division, which no vector loop can.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _mean_around(table, count, x, y, vote2):
    """Weighted mean of the first depths of the `count` lenses around a scene point."""
    weight = total = np.float32(0.0)
    per_vote2 = np.float32(1.0) / vote2
    xs, ys, trusts, sizes = table[_X], table[_Y], table[_TRUST], table[_SIZE]
    for m in range(np.uint64(count)):
        dx, dy = x - xs[m], y - ys[m]
        share = max(np.float32(1.0) - (dx * dx + dy * dy) * per_vote2, np.float32(0.0))
        w = trusts[m] * share * share
        weight += w
        total += w * sizes[m]
    return total / weight


@njit(cache=True, nogil=True, error_model="numpy")
def _measure_distances(table, count, x, y, distance):
    """Squared distances of the `count` lenses around a scene point; returns which of them is the nearest."""
    for m in range(np.uint64(count)):
        dx, dy = x - table[_X, m], y - table[_Y, m]
        distance[m] = dx * dx + dy * dy
    nearest = 0
    for m in range(1, count):
        nearest = m if distance[m] < distance[nearest] else nearest
    return nearest


@njit(cache=True, nogil=True, error_model="numpy")
def _find_central(nearby, count, near_x, near_y):
    """Centres of the nearest of the `count` lenses around a scene point, in order; returns how many."""
    near, distance, most = nearby.central, nearby.distance, len(nearby.central)
    found = 0
    for m in range(count):
        d = distance[m]
        if found == most and d >= distance[near[found - 1]]:
            continue
        at = min(found, most - 1)
        while at > 0 and distance[near[at - 1]] > d:
            near[at] = near[at - 1]
            at -= 1
        near[at] = m
        found = min(found + 1, most)
    for k in range(found):
        near_x[k], near_y[k] = nearby.table[_X, near[k]], nearby.table[_Y, near[k]]
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _find_voters(nearby, count, nearest, vote2, trusted):
    """Lenses that vote for the depth of a scene point, and their weights; how many, and the range of their depths."""
    table, distance, voters, shares = nearby.table, nearby.distance, nearby.voters, nearby.shares
    found = 0
    low, high = np.float32(np.inf), np.float32(-np.inf)
    for m in range(count):
        if m != nearest and (distance[m] > vote2 or table[_TRUST, m] < trusted):
            continue
        share = max(1 - distance[m] / vote2, np.float32(1e-3))
        voters[found], shares[found] = m, table[_TRUST, m] * share * share
        found += 1
        for k in range(_SIZE, len(table)):
            s = table[k, m]
            # No comparison holds of NaN.
            low, high = s if s < low else low, s if s > high else high
    return found, low, high


@njit(cache=True, nogil=True, error_model="numpy")
def _mean_vote(nearby, count, votes):
    """Weighted mean of all depths of `count` voters."""
    table, voters, shares = nearby.table, nearby.voters, nearby.shares
    weight = total = np.float32(0.0)
    for n in range(count):
        for k in range(_SIZE, len(table)):
            s = table[k, voters[n]]
            w = shares[n] * votes[k - _SIZE] if np.isfinite(s) else np.float32(0.0)
            weight += w
            total += w * s if w > 0 else np.float32(0.0)
    return total / weight


@njit(cache=True, nogil=True, error_model="numpy")
def _sort_votes(nearby, count, votes):
    """Depths of `count` voters sorted by patch size, and their weights; returns their number."""
    table, voters, shares, sizes, weights = nearby.table, nearby.voters, nearby.shares, nearby.sizes, nearby.weights
    number = 0
    for n in range(count):
        for k in range(_SIZE, len(table)):
            s = table[k, voters[n]]
            if not np.isfinite(s):
                continue
            at = number
            while at > 0 and sizes[at - 1] > s:
                sizes[at], weights[at] = sizes[at - 1], weights[at - 1]
                at -= 1
            sizes[at], weights[at] = s, votes[k - _SIZE] * shares[n]
            number += 1
    return number


@njit(cache=True, nogil=True, error_model="numpy")
def _cluster_votes(number, nearby, gap, widest, depths, shares):
    """Means and weights of clusters of sorted votes, the weightiest first, as many as there is room for; their number.

    Neighbouring votes of a cluster differ by at most one `gap`, all of them by at most `widest`.
    """
    sizes, weights = nearby.sizes, nearby.weights
    most = len(depths)
    found = start = 0
    while start < number:
        stop = start + 1
        while stop < number and sizes[stop] - sizes[stop - 1] <= gap:
            if sizes[stop] - sizes[start] > widest:
                break
            stop += 1
        weight = total = np.float32(0.0)
        for m in range(start, stop):
            weight += weights[m]
            total += weights[m] * sizes[m]
        at = min(found, most - 1)
        if found < most or weight > shares[most - 1]:
            while at > 0 and shares[at - 1] < weight:
                shares[at], depths[at] = shares[at - 1], depths[at - 1]
                at -= 1
            shares[at], depths[at] = weight, total / weight
            found = min(found + 1, most)
        start = stop
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _measure_mismatch(views, c, central, x, y, everyone, count, hypotheses):
    """Turn the weights of hypotheses in `costs` into their mismatch plus the price of few votes, and move `depths` to
    values beside them that match better; `everyone` is the sum of all weights."""
    depths, costs, seen = hypotheses.depths, hypotheses.costs, hypotheses.seen
    zero, part = np.float32(0.0), np.uint64(WORK)
    nearest = 0
    # All pixels are fetched before the first comparison: what was just written in single values is slow to read as a
    # vector.
    for k in range(count):
        seen[k] = sample_views(views, c, central, x, y, depths[k] / c.pitch, np.uint64(k) * part)
        if depth_order(depths[k], c.pitch) > depth_order(depths[nearest], c.pitch):
            nearest = k
    for k in range(count):
        share = costs[k] / everyone
        least = view_mismatch(views, c, x, y, depths[k] / c.pitch, k == nearest, seen[k], np.uint64(k) * part)
        if share < c.rough and least >= c.good and least != c.unknown:
            base = np.uint64(count) * part
            depths[k], least = _try_beside(views, c, central, x, y, depths[k], least, k == nearest, base)
        costs[k] = least + c.unvoted_cost * max(zero, 1 - share)


@njit(cache=True, nogil=True, error_model="numpy")
def _try_beside(views, c, central, x, y, s, least, nearest, base):
    """The patch size among `s`, of mismatch `least`, and those a little beside it that matches best; its mismatch."""
    nudge = c.nudge * c.gap
    low, high, other = (s - nudge) / c.pitch, (s + nudge) / c.pitch, base + np.uint64(WORK)
    seen_low = sample_views(views, c, central, x, y, low, base)
    seen_high = sample_views(views, c, central, x, y, high, other)
    below = c.nudge_cost + view_mismatch(views, c, x, y, low, nearest, seen_low, base)
    above = c.nudge_cost + view_mismatch(views, c, x, y, high, nearest, seen_high, other)
    if above < min(least, below):
        return s + nudge, above
    if below < least:
        return s - nudge, below
    return s, least


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def propose_hypotheses(
    image, table, around, ring, agreeing, grid: SceneGrid, constants: HypothesisConstants, changed, old, coarse, depths,
    costs,
):  # fmt: skip
    """Depth hypotheses of each scene point in `depths`, their cost in `costs`, both (most, rows, columns).

    A point on whose depth all lenses around agree has one hypothesis; the place after the last one is NaN; places
    beyond, and the costs of single hypotheses, are left as they are.

    Parameters
    ----------
    image : (H, W) float32
    table : (n, 6) float32
        Centre of each lens, its weight, and its patch size, second-best one and that of the second layer.
    around : (n, k) int32
        Rows of the lenses of `ring` (k, 2) about each.
    agreeing : (n,) int8
        As `find_agreeing_lenses`.
    grid : SceneGrid
    constants : HypothesisConstants
    changed, old : (rows, columns)
        Points that are not `changed` have that of the `old` surface as their only hypothesis; both may be (0, 0).
    coarse : (rows / 2, columns / 2) float32
        Surface of twice the spacing: where its values about a point agree, their mean is the only hypothesis, elsewhere
        only those that one of them has; (0, 0) if there is none.
    """
    most, rows, columns = depths.shape
    pixels, c, gap = image.reshape(-1), constants, constants.gap
    votes = np.float32(1.0), c.second_weight, np.float32(1.0)
    nearby_count, known = len(ring), table.shape[1]
    # Depth edges are clustered: the stride spreads them over the threads.
    stride = coprime_stride(rows)
    for row in prange(rows):
        v = row * stride % rows
        nearby = _Nearby(
            np.empty((known, nearby_count), np.float32), np.empty(nearby_count, np.float32),
            np.empty(nearby_count, np.int64), np.empty(nearby_count, np.float32), np.empty(MAX_VIEWS, np.int64),
            np.empty(known * nearby_count, np.float32), np.empty(known * nearby_count, np.float32),
        )  # fmt: skip
        views = PatchViews(
            image, pixels, np.empty(MAX_VIEWS, np.float32), np.empty(MAX_VIEWS, np.float32),
            np.zeros((most + 2) * WORK, np.float32),
        )  # fmt: skip
        own = _Hypotheses(
            np.empty(most, np.float32), np.empty(most, np.float32), np.empty(most, np.float32), np.empty(most, np.int64)
        )
        values, differ = np.empty(columns + 2, np.float32), np.ones(columns + 2, np.bool_)
        if coarse.size > 0:
            _interpolate_row(coarse, v, gap, values, differ)
        count = 0
        around_i, around_j = 2**62, 0
        for u in range(columns):
            depths[0, v, u], depths[1, v, u] = values[u], np.nan
            if old.size > 0 and not changed[v, u]:
                depths[0, v, u] = old[v, u]
                continue
            if not differ[u]:
                continue
            at_i, at_j = nearest_lens(grid, u, v)
            i, j = int(at_i), int(at_j)
            lens = lens_at(grid, i, j)
            if lens >= 0 and agreeing[lens] == _ALONE:
                depths[0, v, u] = table[lens, _SIZE]
                continue
            # Consecutive points mostly lie in the cell of one lens.
            if i != around_i or j != around_j:
                count = _gather_table(table, around, grid, ring, i, j, lens, nearby.table)
                around_i, around_j = i, j
            x, y = np.float32(grid.first + u * grid.spacing), np.float32(grid.first + v * grid.spacing)
            if lens >= 0 and agreeing[lens]:
                depths[0, v, u] = _mean_around(nearby.table, count, x, y, c.vote2)
                continue
            nearest = _measure_distances(nearby.table, count, x, y, nearby.distance)
            voters, lowest, highest = _find_voters(nearby, count, nearest, c.vote2, c.trusted)
            if voters == 0 or highest - lowest <= gap:
                depths[0, v, u] = _mean_vote(nearby, voters, votes) if voters else np.float32(np.nan)
                continue
            number = _sort_votes(nearby, voters, votes)
            found = _cluster_votes(number, nearby, gap, c.widest * gap, own.depths, own.costs)
            if coarse.size > 0:
                found = _keep_coarse(coarse, v, u, gap, own.depths, own.costs, found)
            if found > 1:
                central = _find_central(nearby, count, views.near_x, views.near_y)
                _measure_mismatch(views, c, central, x, y, nearby.shares[:voters].sum(), found, own)
                _add_occlusion(found, own, c)
                for k in range(1, found):
                    depths[k, v, u], costs[k, v, u] = own.depths[k], own.costs[k]
                if found < most:
                    depths[found, v, u] = np.nan
                costs[0, v, u] = own.costs[0]
            depths[0, v, u] = own.depths[0]
