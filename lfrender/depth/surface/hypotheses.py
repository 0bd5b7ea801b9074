"""Depth hypotheses of each scene point, from the lenses around it, and the mismatch of each on the
pixels.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lfcal.runtime.kernels import FAST, kernel

from ...flat.lens_graph import nearest_index
from ..same_surface import depth_order
from .scene_grid import LensArray, PointGrid, lens_at

__all__ = ["MAX_HYPOTHESES", "propose_hypotheses"]

# Only so many lenses, the most central ones, are compared.
_MAX_VIEWS = 6
# Mismatch of places that too few lenses show, or of noise alone.
_UNKNOWN = 0.5


@njit(error_model="numpy", fastmath=FAST, forceinline=True)
def _sample(pixels, width, px, py, out):
    """Fill `out` with 3 x 3 samples about (px, py), a pixel apart, their mean and variance."""
    i = int(px)
    j = int(py)
    fx = px - np.float32(i)
    fy = py - np.float32(j)
    mean = squares = p = q = r = np.float32(0)
    for v in range(4):
        at = np.uint64((j - 1 + v) * width + i - 1)
        above = p
        between = q
        below = r
        a = pixels[at]
        b = pixels[at + np.uint64(1)]
        c = pixels[at + np.uint64(2)]
        d = pixels[at + np.uint64(3)]
        p = a + fx * (b - a)
        q = b + fx * (c - b)
        r = c + fx * (d - c)
        if v > 0:
            left = above + fy * (p - above)
            middle = between + fy * (q - between)
            right = below + fy * (r - below)
            out[3 * v - 3], out[3 * v - 2], out[3 * v - 1] = left, middle, right
            mean += left + middle + right
            squares += left * left + middle * middle + right * right
    mean /= 9
    out[9], out[10] = mean, max(squares / 9 - mean * mean, np.float32(0))


@njit(error_model="numpy", fastmath=FAST, forceinline=True)
def _compare(own, other, half, floor):
    """Mismatch of two views."""
    squares = np.float32(0)
    apart = own[9] - other[9]
    for k in range(9):
        squares += (own[k] - other[k]) * (own[k] - other[k])
    return (squares / 9 + half) / (own[10] + other[10] + floor + apart * apart)


@njit(error_model="numpy", forceinline=True)
def view_mismatch(image, near_x, near_y, count, x, y, slope, radius, floor, samples, costs):
    """Mean mismatch of the better part of the views of scene point (x, y) with the most central
    one, and their number.

    0 for equal views, about 1 for unrelated ones, `_UNKNOWN` where there is one. The first `count`
    lenses have their centres at `near_x`, `near_y`, the nearest first; the depth is `slope` = s /
    D; a mismatch of `floor` is noise.
    """
    height, width = image.shape
    pixels = image.reshape(-1)
    one = np.float32(1.0)
    unknown = np.float32(_UNKNOWN)
    right = np.float32(width) - np.float32(2.001)
    bottom = np.float32(height) - np.float32(2.001)
    seen = 0
    for m in range(count):
        dx = -(x - near_x[m]) * slope
        dy = -(y - near_y[m]) * slope
        # Those after it are farther. The first counts in any case.
        if m > 0 and dx * dx + dy * dy > radius * radius:
            break
        px = min(max(near_x[m] + dx, one), right)
        py = min(max(near_y[m] + dy, one), bottom)
        _sample(pixels, width, px, py, samples[m])
        seen += 1
    if seen < 2:
        return unknown, seen
    # Half of the others: an occluder may hide the rest.
    better = seen // 2
    for m in range(1, seen):
        cost = _compare(samples[0], samples[m], unknown * floor, floor)
        at = m - 1
        while at > 0 and costs[at - 1] > cost:
            costs[at] = costs[at - 1]
            at -= 1
        costs[at] = cost
    return costs[:better].sum() / np.float32(better), seen


#: Hypotheses of one scene point, at most.
MAX_HYPOTHESES = 5

# Rows of the table of a lens: its centre, its weight, and from the last one on its depths.
_X, _Y, _TRUST, _SIZE = range(4)


@njit(error_model="numpy")
def _gather_table(table, lookup, low, ring, i, j, out):
    """Copy the `table` of the lenses around lens (i, j) to columns of `out`; returns how many there
    are.
    """
    count = 0
    for r in range(len(ring)):
        other = lens_at(lookup, low, i + ring[r, 0], j + ring[r, 1])
        if other >= 0:
            for k in range(len(out)):
                out[k, count] = table[other, k]
            count += 1
    return count


# Python's error model checks every division for zero, which prevents vector loops.
@njit(fastmath=FAST, error_model="numpy")
def _mean_around(table, count, x, y, vote2):
    """Weighted mean of the first depths of the `count` lenses around a scene point; NaN if there
    are none.
    """
    weight = total = np.float32(0.0)
    per_vote2 = np.float32(1.0) / vote2
    xs = table[_X]
    ys = table[_Y]
    trusts = table[_TRUST]
    sizes = table[_SIZE]
    for m in range(np.uint64(count)):
        dx = x - xs[m]
        dy = y - ys[m]
        # Beyond the border of the lattice all are far.
        share = max(np.float32(1.0) - (dx * dx + dy * dy) * per_vote2, np.float32(1e-6))
        w = trusts[m] * share * share
        weight += w
        total += w * sizes[m]
    return total / weight if count > 0 else np.float32(np.nan)


@njit(error_model="numpy")
def _find_voters(table, count, x, y, vote2, distance, voters, shares):
    """Squared distances of the `count` lenses around a scene point, those that vote for its depth,
    and their weights; how many, and the range of their depths.
    """
    for m in range(np.uint64(count)):
        dx = x - table[_X, m]
        dy = y - table[_Y, m]
        distance[m] = dx * dx + dy * dy
    nearest = found = 0
    for m in range(1, count):
        nearest = m if distance[m] < distance[nearest] else nearest
    low = np.float32(np.inf)
    high = np.float32(-np.inf)
    for m in range(count):
        if m != nearest and distance[m] > vote2:
            continue
        share = max(1 - distance[m] / vote2, np.float32(1e-3))
        voters[found], shares[found] = m, table[_TRUST, m] * share * share
        found += 1
        for k in range(_SIZE, len(table)):
            s = table[k, m]
            # Comparisons with NaN are false.
            low = s if s < low else low
            high = s if s > high else high
    return found, high - low


@njit(error_model="numpy")
def _find_central(table, count, distance, near, near_x, near_y):
    """Centres of the nearest of the `count` lenses around a scene point, in order; returns how
    many.
    """
    most = len(near)
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
        near_x[k], near_y[k] = table[_X, near[k]], table[_Y, near[k]]
    return found


@njit(error_model="numpy")
def _sort_votes(table, count, voters, shares, sizes, weights):
    """Depths of `count` voters sorted by patch size, and their weights."""
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
            sizes[at], weights[at] = s, shares[n]
            number += 1
    return number


@njit(error_model="numpy")
def _cluster_votes(number, sizes, weights, gap, depths, shares):
    """Means and weights of clusters of sorted votes, within one `gap`, the weightiest first; their
    number.
    """
    most = len(depths)
    found = start = 0
    while start < number:
        stop = start + 1
        while stop < number and sizes[stop] - sizes[start] <= gap:
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


@njit(error_model="numpy", forceinline=True)
def _measure_mismatch(
    image,
    near_x,
    near_y,
    central,
    x,
    y,
    pitch,
    radius,
    floor,
    everyone,
    depths,
    costs,
    samples,
    views,
):
    """Turn the weights of hypotheses in `costs`, out of `everyone`, into their mismatch plus the
    price of few votes.
    """
    nearest = 0
    count = len(depths)
    unknown = np.float32(_UNKNOWN)
    none = np.float32(0.0)
    for k in range(count):
        if depth_order(depths[k], pitch) > depth_order(depths[nearest], pitch):
            nearest = k
    for k in range(count):
        cost, seen = view_mismatch(
            image, near_x, near_y, central, x, y, depths[k] / pitch, radius, floor, samples, views
        )
        if k != nearest and cost > unknown:
            # Behind another depth, where views may be occluded, a mismatch tells less.
            cost = unknown + (cost - unknown) * np.float32(seen) / np.float32(seen + 2)
        # A depth that no lens around votes for costs a little more.
        costs[k] = cost + np.float32(0.07) * max(none, 1 - costs[k] / everyone)
    # Past the edge of a nearer surface the one behind it matches as well.
    for k in range(count):
        nearer = none
        for q in range(count):
            if depth_order(depths[q], pitch) > depth_order(depths[k], pitch):
                nearer = max(nearer, unknown - costs[q])
        views[k] = nearer
    for k in range(count):
        costs[k] += 2 * views[k]


@kernel(error_model="numpy", share=lambda *given: given[6].shape[1])
def propose_hypotheses(
    begin,
    end,
    image,
    table,
    agreeing,
    lenses: LensArray,
    grid: PointGrid,
    floor,
    depths,
    costs,
    wanted,
):
    """Depth hypotheses of each `wanted` scene point in `depths`, their cost in `costs`, both (most,
    rows, columns).

    Where all lenses around agree there is one; the place after the last one stays NaN. `table`
    (n, 5) float32 holds the centre of each lens, its weight and its two patch sizes; around the
    `agreeing` ones (n,) all have one depth. A squared difference of views up to `floor` is noise.
    """
    most, _, columns = depths.shape
    # Arrays are taken out of the tuple once: each access counts references.
    ring = lenses.ring
    lookup = lenses.rows
    low = lenses.low
    origin = lenses.origin
    inverse = lenses.inverse
    bend = lenses.bend
    bend_low = lenses.bend_low
    first = grid.first
    spacing = grid.spacing
    gap = np.float32(lenses.gap)
    pitch = np.float32(lenses.pitch)
    radius = np.float32(lenses.radius)
    # Lenses within 1.45 pitches vote for the depth of a point.
    vote2 = np.float32(2.1) * pitch * pitch
    most_near = len(ring)
    known = table.shape[1]
    for v in range(begin, end):
        nearby = np.empty((known, most_near), np.float32)
        distance = np.empty(most_near, np.float32)
        voters = np.empty(most_near, np.int64)
        shares = np.empty(most_near, np.float32)
        sizes = np.empty(known * most_near, np.float32)
        weights = np.empty(known * most_near, np.float32)
        near_x = np.empty(_MAX_VIEWS, np.float32)
        near_y = np.empty(_MAX_VIEWS, np.float32)
        own = np.empty(most, np.float32)
        prices = np.empty(most, np.float32)
        central = np.empty(_MAX_VIEWS, np.int64)
        views = np.empty(_MAX_VIEWS, np.float32)
        samples = np.empty((_MAX_VIEWS, 11), np.float32)
        count = 0
        around_i = 2**62
        around_j = 0
        for u in range(columns):
            if not wanted[v, u]:
                continue
            x = first + u * spacing
            y = first + v * spacing
            at_i, at_j = nearest_index(x, y, origin, inverse, bend, bend_low)
            i = int(at_i)
            j = int(at_j)
            lens = lens_at(lookup, low, i, j)
            # Consecutive points mostly lie in the cell of one lens.
            if i != around_i or j != around_j:
                count = _gather_table(table, lookup, low, ring, i, j, nearby)
                around_i = i
                around_j = j
            px = np.float32(x)
            py = np.float32(y)
            if lens >= 0 and agreeing[lens]:
                depths[0, v, u] = _mean_around(nearby, count, px, py, vote2)
                continue
            found, apart = _find_voters(nearby, count, px, py, vote2, distance, voters, shares)
            if found == 0 or apart <= gap:
                depths[0, v, u] = _mean_around(nearby, count, px, py, vote2)
                continue
            everyone = shares[:found].sum()
            number = _sort_votes(nearby, found, voters, shares, sizes, weights)
            found = _cluster_votes(number, sizes, weights, gap, own, prices)
            if found > 1:
                shown = _find_central(nearby, count, distance, central, near_x, near_y)
                _measure_mismatch(
                    image,
                    near_x,
                    near_y,
                    shown,
                    px,
                    py,
                    pitch,
                    radius,
                    floor,
                    everyone,
                    own[:found],
                    prices[:found],
                    samples,
                    views,
                )
                for k in range(1, found):
                    depths[k, v, u], costs[k, v, u] = own[k], prices[k]
                if found < most:
                    depths[found, v, u] = np.nan
                costs[0, v, u] = prices[0]
            depths[0, v, u] = own[0]
