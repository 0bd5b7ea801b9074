"""Depths that compete for each scene point, and how well the microimages agree on each."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from lfcal.runtime.fastmath import FAST

from ...flat.distorted_lookup import nearest_index
from ...runtime.scheduling import coprime_stride
from .occlusion import depth_order
from .photoconsistency import MOST_VIEWS, UNKNOWN, WORK, sample_views, view_mismatch

__all__ = ["MAX_HYPOTHESES", "find_agreeing_lenses", "propose_hypotheses"]

MAX_HYPOTHESES = 5
# A place behind another may match as well, past the edge of the nearer one; so each candidate pays this many times
# what a nearer one stays below that mismatch.
_HIDDEN, _MATCHED = np.float32(2.0), np.float32(0.5)
# Votes belong to one surface as long as they extend over no more than so many gaps.
_WIDEST = np.float32(2.0)
# Price of a depth that none of the lenses around votes for, in units of the mismatch.
_PRIOR = np.float32(0.07)
# What fewer than this share of the lenses around vote for is known roughly: values beside it are tried as well, this
# share of a gap away, at the price of a depth without votes.
_ROUGH, _NUDGE, _NUDGED = np.float32(0.4), np.float32(0.3), np.float32(0.07)
# Better matches than this are not improved upon.
_GOOD = np.float32(0.2)
# What is known of each lens: its centre, its trust, and from the last place on its depths.
_X, _Y, _TRUST, _SIZE = 0, 1, 2, 3
# Weight of the first depth of a lens, of its second best, and of that of what the first leaves unexplained: a second
# best is false in every fourth lens, and nothing has refined it.
_VOTES = (np.float32(1.0), np.float32(0.1), np.float32(1.0))
# Lenses below this trust say nothing about the places around them where others do.
_TRUSTED = np.float32(0.1)
# How `find_agreeing_lenses` marks lenses far from any that is trusted: whatever is drawn there, nothing shows it.
_ALONE = np.int8(2)


@njit(cache=True, nogil=True, error_model="numpy")
def _hide(depths, costs, pitch, evidence):
    """Raise the mismatch of each candidate by the evidence for a nearer one."""
    for k in range(len(depths)):
        evidence[k] = max(_MATCHED - costs[k], np.float32(0.0))
    for k in range(len(depths)):
        hidden = np.float32(0.0)
        for q in range(len(depths)):
            if depth_order(depths[q], pitch) > depth_order(depths[k], pitch):
                hidden = max(hidden, evidence[q])
        costs[k] += _HIDDEN * hidden


@njit(cache=True, nogil=True, inline="always")
def _lens_at(grid, low, i, j):
    ci, cj = i - low[0], j - low[1]
    if ci < 0 or cj < 0 or cj >= grid.shape[0] or ci >= grid.shape[1]:
        return -1
    return grid[cj, ci]


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def find_agreeing_lenses(values, seconds, trust, indices, grid, low, ring, gap):
    """(n,) int8: 1 for lenses that agree with all trusted lenses of `ring` about them to within one `gap`.

    2 where none of them is trusted, nor the lens itself; 0 elsewhere.
    """
    calm = np.empty(len(values), np.int8)
    for lens in prange(len(values)):
        lowest = highest = values[lens]
        single, alone = True, trust[lens] < _TRUSTED
        for r in range(len(ring)):
            other = _lens_at(grid, low, indices[lens, 0] + ring[r, 0], indices[lens, 1] + ring[r, 1])
            if other < 0 or trust[other] < _TRUSTED:
                continue
            alone = False
            lowest = min(lowest, values[other])
            highest = max(highest, values[other])
            for m in range(seconds.shape[1]):
                single = single and not np.isfinite(seconds[other, m])
        calm[lens] = _ALONE if alone else single and highest - lowest <= gap
    return calm


@njit(cache=True, nogil=True, error_model="numpy")
def _carry(coarse, v, gap, values, torn):
    """Row `v` of a grid from one of twice the spacing: means of the `coarse` values about each place, in `values`, and
    whether those differ by more than a `gap`, in `torn`. Both have two places for each column of that."""
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
        torn[2 * x + 1] = highest - lowest > gap or np.isnan(values[2 * x + 1])
        torn[2 * x] = max(highest, high[left]) - min(lowest, low[left]) > gap or np.isnan(values[2 * x])


@njit(cache=True, nogil=True, error_model="numpy")
def _chosen(coarse, v, u, gap, depths, prices, count):
    """Keep those of `count` candidates that a value of twice the spacing about place (v, u) has; all if none has."""
    kept = 0
    for k in range(count):
        near = False
        for y in range(max(v - 1, 0) // 2, min((v + 2) // 2, len(coarse) - 1) + 1):
            for x in range(max(u - 1, 0) // 2, min((u + 2) // 2, coarse.shape[1] - 1) + 1):
                near = near or abs(coarse[y, x] - depths[k]) <= gap
        if near:
            depths[kept], prices[kept] = depths[k], prices[k]
            kept += 1
    return kept if kept else count


@njit(cache=True, nogil=True, error_model="numpy")
def _around(table, rows, grid, low, ring, i, j, lens, there):
    """Put the `table` of the lenses around lens (i, j) beside each other; returns how many there are."""
    count = 0
    for r in range(len(ring)):
        other = rows[lens, r] if lens >= 0 else _lens_at(grid, low, i + ring[r, 0], j + ring[r, 1])
        if other >= 0:
            for k in range(len(there)):
                there[k, count] = table[other, k]
            count += 1
    return count


# Python's error model checks every division, which no vector loop can.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _mean_around(there, count, x, y, vote2):
    """Weighted mean of the answers of the `count` lenses around a scene point."""
    weight = total = np.float32(0.0)
    per_vote2 = np.float32(1.0) / vote2
    xs, ys, trusts, sizes = there[_X], there[_Y], there[_TRUST], there[_SIZE]
    for m in range(np.uint64(count)):
        dx, dy = x - xs[m], y - ys[m]
        share = max(np.float32(1.0) - (dx * dx + dy * dy) * per_vote2, np.float32(0.0))
        w = trusts[m] * share * share
        weight += w
        total += w * sizes[m]
    return total / weight


@njit(cache=True, nogil=True, error_model="numpy")
def _gather(there, count, x, y, distance):
    """Squared distances of the `count` lenses around a scene point, and which of them is the nearest."""
    for m in range(np.uint64(count)):
        dx, dy = x - there[_X, m], y - there[_Y, m]
        distance[m] = dx * dx + dy * dy
    nearest = 0
    for m in range(1, count):
        nearest = m if distance[m] < distance[nearest] else nearest
    return nearest


@njit(cache=True, nogil=True, error_model="numpy")
def _central(there, count, distance, near, near_x, near_y):
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
        near_x[k], near_y[k] = there[_X, near[k]], there[_Y, near[k]]
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _voices(there, count, nearest, distance, vote2, voters, shares):
    """Lenses that vote for the depth of a scene point, and their weights; how many, and the range of their answers."""
    found = 0
    low, high = np.float32(np.inf), np.float32(-np.inf)
    for m in range(count):
        if m != nearest and (distance[m] > vote2 or there[_TRUST, m] < _TRUSTED):
            continue
        share = max(1 - distance[m] / vote2, np.float32(1e-3))
        voters[found], shares[found] = m, there[_TRUST, m] * share * share
        found += 1
        for k in range(_SIZE, len(there)):
            s = there[k, m]
            # No comparison holds of NaN.
            low, high = s if s < low else low, s if s > high else high
    return found, low, high


@njit(cache=True, nogil=True, error_model="numpy")
def _mean_vote(there, count, voters, shares):
    """Weighted mean of all answers of `count` lenses."""
    weight = total = np.float32(0.0)
    for n in range(count):
        for k in range(_SIZE, len(there)):
            s = there[k, voters[n]]
            w = shares[n] * _VOTES[k - _SIZE] if np.isfinite(s) else np.float32(0.0)
            weight += w
            total += w * s if w > 0 else np.float32(0.0)
    return total / weight


@njit(cache=True, nogil=True, error_model="numpy")
def _sorted_votes(there, count, voters, shares, sizes, weights):
    """Answers of `count` lenses sorted by patch size, and what they count; returns their number."""
    votes = 0
    for n in range(count):
        for k in range(_SIZE, len(there)):
            s = there[k, voters[n]]
            if not np.isfinite(s):
                continue
            at = votes
            while at > 0 and sizes[at - 1] > s:
                sizes[at], weights[at] = sizes[at - 1], weights[at - 1]
                at -= 1
            sizes[at], weights[at] = s, _VOTES[k - _SIZE] * shares[n]
            votes += 1
    return votes


@njit(cache=True, nogil=True, error_model="numpy")
def _clusters(votes, sizes, weights, gap, depths, shares):
    """Clusters of sorted votes, the weightiest first, as many as there is room for; returns their number."""
    most = len(depths)
    found = start = 0
    while start < votes:
        stop = start + 1
        while stop < votes and sizes[stop] - sizes[stop - 1] <= gap:
            if sizes[stop] - sizes[start] > _WIDEST * gap:
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
def _compete(
    image, pixels, near_x, near_y, count, x, y, everyone, pitch, radius, step, floor, gap, depths, costs, views, work
):  # fmt: skip
    """Turn the weights of candidates in `costs` into their mismatch, and move `depths` to what matches better."""
    zero, part = np.float32(0.0), np.uint64(WORK)
    nearest = 0
    # All are read before the first is judged: what is written by single values cannot be read as vectors at once.
    for k in range(len(depths)):
        views[k] = sample_views(
            image, pixels, near_x, near_y, count, x, y, depths[k] / pitch, radius, step, work, np.uint64(k) * part
        )
        if depth_order(depths[k], pitch) > depth_order(depths[nearest], pitch):
            nearest = k
    for k in range(len(depths)):
        share = costs[k] / everyone
        least = view_mismatch(
            image, near_x, near_y, x, y, depths[k] / pitch, step, floor, k == nearest, views[k], work,
            np.uint64(k) * part,
        )  # fmt: skip
        # What matches well needs no better value, and what is hidden in all views finds none.
        if share < _ROUGH and least >= _GOOD and least != UNKNOWN:
            depths[k], least = _nudged(
                image, pixels, near_x, near_y, count, x, y, depths[k], least, _NUDGE * gap, pitch, radius, step, floor,
                k == nearest, work, np.uint64(len(depths)) * part,
            )  # fmt: skip
        costs[k] = least + _PRIOR * max(zero, 1 - share)


@njit(cache=True, nogil=True, error_model="numpy")
def _nudged(
    image, pixels, near_x, near_y, count, x, y, s, least, nudge, pitch, radius, step, floor, nearest, work, base
):  # fmt: skip
    """The patch size among `s`, of mismatch `least`, and those a `nudge` beside it that matches best; its mismatch."""
    low, high, other = (s - nudge) / pitch, (s + nudge) / pitch, base + np.uint64(WORK)
    views_low = sample_views(image, pixels, near_x, near_y, count, x, y, low, radius, step, work, base)
    views_high = sample_views(image, pixels, near_x, near_y, count, x, y, high, radius, step, work, other)
    below = _NUDGED + view_mismatch(image, near_x, near_y, x, y, low, step, floor, nearest, views_low, work, base)
    above = _NUDGED + view_mismatch(image, near_x, near_y, x, y, high, step, floor, nearest, views_high, work, other)
    if above < min(least, below):
        return s + nudge, above
    if below < least:
        return s - nudge, below
    return s, least


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def propose_hypotheses(
    image, table, around, radius, pitch, calm, grid, low, origin, inverse, bend, bend_low, ring, gap, floor, first,
    spacing, vote2, step, unsettled, old, coarse, depths, costs,
):  # fmt: skip
    """Candidate depths of each scene point, from the lenses around it, in `depths`, their mismatch in `costs`.

    Both are (most, rows, columns). `table` (n, 6) float32 holds the centre of each lens, its trust, and its patch
    size, next best one and that of the remainder; `around` (n, k) the rows of the lenses of `ring` about it. Points
    that are not `unsettled` (rows, columns) have that of the `old` surface as their only candidate; both may be (0,
    0). Where the values of a `coarse` surface of twice the spacing agree about a point, their mean is the only one,
    elsewhere those that they have are; (0, 0) where there is none. The place after the last candidate is NaN; those
    beyond, and the costs of single candidates, are left as they are. A point on whose depth all lenses around agree
    has one candidate.
    """
    most, rows, columns = depths.shape
    pixels = image.reshape(-1)
    nearby, known = len(ring), table.shape[1]
    # Contested places come in clusters: strides spread them over the threads.
    stride = coprime_stride(rows)
    for row in prange(rows):
        v = row * stride % rows
        distance, shares = np.empty(nearby, np.float32), np.empty(nearby, np.float32)
        voters, near = np.empty(nearby, np.int64), np.empty(MOST_VIEWS, np.int64)
        near_x, near_y = np.empty(MOST_VIEWS, np.float32), np.empty(MOST_VIEWS, np.float32)
        sizes, weights = np.empty(known * nearby, np.float32), np.empty(known * nearby, np.float32)
        own, prices, evidence = np.empty(most, np.float32), np.empty(most, np.float32), np.empty(most, np.float32)
        work, views = np.zeros((most + 2) * WORK, np.float32), np.empty(most, np.int64)
        # The lenses around that by which the last scene points lay.
        there = np.empty((known, nearby), np.float32)
        values, torn = np.empty(columns + 2, np.float32), np.ones(columns + 2, np.bool_)
        if coarse.size > 0:
            _carry(coarse, v, gap, values, torn)
        count = 0
        around_i, around_j = 2**62, 0
        for u in range(columns):
            x, y = np.float32(first + u * spacing), np.float32(first + v * spacing)
            depths[0, v, u], depths[1, v, u] = values[u], np.nan
            if old.size > 0 and not unsettled[v, u]:
                depths[0, v, u] = old[v, u]
                continue
            if not torn[u]:
                continue
            at_i, at_j = nearest_index(first + u * spacing, first + v * spacing, origin, inverse, bend, bend_low)
            i, j = int(at_i), int(at_j)
            lens = _lens_at(grid, low, i, j)
            if lens >= 0 and calm[lens] == _ALONE:
                depths[0, v, u] = table[lens, _SIZE]
                continue
            if i != around_i or j != around_j:
                count = _around(table, around, grid, low, ring, i, j, lens, there)
                around_i, around_j = i, j
            if lens >= 0 and calm[lens]:
                depths[0, v, u] = _mean_around(there, count, x, y, vote2)
                continue
            nearest = _gather(there, count, x, y, distance)
            voices, least, largest = _voices(there, count, nearest, distance, vote2, voters, shares)
            if voices == 0 or largest - least <= gap:
                depths[0, v, u] = _mean_vote(there, voices, voters, shares) if voices else np.float32(np.nan)
                continue
            votes = _sorted_votes(there, voices, voters, shares, sizes, weights)
            found = _clusters(votes, sizes, weights, gap, own, prices)
            if coarse.size > 0:
                found = _chosen(coarse, v, u, gap, own, prices, found)
            if found > 1:
                _compete(
                    image, pixels, near_x, near_y, _central(there, count, distance, near, near_x, near_y), x, y,
                    shares[:voices].sum(), pitch, radius, step, floor, gap, own[:found], prices[:found], views, work,
                )  # fmt: skip
                _hide(own[:found], prices[:found], pitch, evidence)
                for k in range(1, found):
                    depths[k, v, u], costs[k, v, u] = own[k], prices[k]
                if found < most:
                    depths[found, v, u] = np.nan
                costs[0, v, u] = prices[0]
            depths[0, v, u] = own[0]
