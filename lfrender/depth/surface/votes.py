"""The lenses around a scene point: their mean depth, and clusters of their depths weighted by distance."""

from __future__ import annotations

import numpy as np
from numba import njit

from lfcal.runtime.kernels import FAST

from .scene_grid import lens_at

__all__ = ["cluster_votes", "find_central", "find_voters", "gather_table", "mean_around", "sort_votes"]

# Rows of the table of a lens: its centre, its weight, and from the last one on its depths.
_X, _Y, _TRUST, _SIZE = range(4)


@njit(error_model="numpy")
def gather_table(table, rows, lookup, low, ring, i, j, lens, out):
    """Copy the `table` of the lenses around lens (i, j) to columns of `out`; returns how many there are."""
    count = 0
    for r in range(len(ring)):
        other = rows[lens, r] if lens >= 0 else lens_at(lookup, low, i + ring[r, 0], j + ring[r, 1])
        if other >= 0:
            for k in range(len(out)):
                out[k, count] = table[other, k]
            count += 1
    return count


# Python's error model checks every division for zero, which prevents vector loops.
@njit(fastmath=FAST, error_model="numpy")
def mean_around(table, count, x, y, vote2):
    """Weighted mean of the first depths of the `count` lenses around a scene point; NaN if there are none."""
    weight = total = np.float32(0.0)
    per_vote2 = np.float32(1.0) / vote2
    xs, ys, trusts, sizes = table[_X], table[_Y], table[_TRUST], table[_SIZE]
    for m in range(np.uint64(count)):
        dx, dy = x - xs[m], y - ys[m]
        # Beyond the border of the lattice all are far.
        share = max(np.float32(1.0) - (dx * dx + dy * dy) * per_vote2, np.float32(1e-6))
        w = trusts[m] * share * share
        weight += w
        total += w * sizes[m]
    return total / weight if count > 0 else np.float32(np.nan)


@njit(error_model="numpy")
def find_voters(table, count, x, y, vote2, distance, voters, shares):
    """Squared distances of the `count` lenses around a scene point, those that vote for its depth, and their weights;
    how many, and the range of their depths."""
    for m in range(np.uint64(count)):
        dx, dy = x - table[_X, m], y - table[_Y, m]
        distance[m] = dx * dx + dy * dy
    nearest = found = 0
    for m in range(1, count):
        nearest = m if distance[m] < distance[nearest] else nearest
    low, high = np.float32(np.inf), np.float32(-np.inf)
    for m in range(count):
        if m != nearest and distance[m] > vote2:
            continue
        share = max(1 - distance[m] / vote2, np.float32(1e-3))
        voters[found], shares[found] = m, table[_TRUST, m] * share * share
        found += 1
        for k in range(_SIZE, len(table)):
            s = table[k, m]
            # Comparisons with NaN are false.
            low, high = s if s < low else low, s if s > high else high
    return found, high - low


@njit(error_model="numpy")
def find_central(table, count, distance, near, near_x, near_y):
    """Centres of the nearest of the `count` lenses around a scene point, in order; returns how many."""
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
def sort_votes(table, count, voters, shares, votes, sizes, weights):
    """Depths of `count` voters sorted by patch size, and their weights; returns their number."""
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


@njit(error_model="numpy")
def cluster_votes(number, sizes, weights, gap, depths, shares):
    """Means and weights of clusters of sorted votes, the weightiest first, as many as there is room for; their number.

    The votes of a cluster differ by at most one `gap`.
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
