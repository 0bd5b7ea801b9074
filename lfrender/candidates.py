"""Depths that compete for each scene point, and how well the microimages agree on each."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from .bending import nearest_index
from .fastmath import FAST
from .visibility import nearness

__all__ = ["MOST_CANDIDATES", "calm_lenses", "propose"]

MOST_CANDIDATES = 5
# Half width of the patch on which candidate depths compete, in samples.
_PATCH = 1
# Lenses compared with the most central one for each candidate.
_MOST_VIEWS = 5
# So many of the most central lenses are each compared with the others: an occluder may hide the place from the first.
_REFERENCES = 2
# Share of the views that must agree: nothing hides the nearest candidate, while half of the views of one behind it may
# be hidden.
_OPEN, _HALF = np.float32(0.7), np.float32(0.5)
# A place behind another may match as well, past the edge of the nearer one; so each candidate pays this many times
# what a nearer one stays below that mismatch.
_HIDDEN, _MATCHED = np.float32(2.0), np.float32(0.5)
# Votes belong to one surface as long as they extend over no more than so many gaps.
_WIDEST = np.float32(2.0)
# Price of a depth that none of the lenses around votes for, in units of the mismatch.
_PRIOR = np.float32(0.07)
# Mismatch of places that tell nothing: too few views show them, or noise explains their contrast.
_UNKNOWN = np.float32(0.5)
# A candidate behind another that mismatches in so many views, as if all were hidden, counts half as much as it would.
_HALF_VIEWS = np.float32(2.0)
# What fewer than this share of the lenses around vote for is known roughly: values beside it are tried as well, this
# share of a gap away, at the price of a depth without votes.
_ROUGH, _NUDGE, _NUDGED = np.float32(0.4), np.float32(0.3), np.float32(0.07)
# Better matches than this are not improved upon.
_GOOD = np.float32(0.2)
# Weight of the first depth of a lens, of its second best, and of that of what the first leaves unexplained: a second
# best is false in every fourth lens, and nothing has refined it.
_VOTES = (np.float32(1.0), np.float32(0.1), np.float32(1.0))
# Lenses below this trust say nothing about the places around them where others do.
_TRUSTED = np.float32(0.1)
# How `calm_lenses` marks lenses far from any that is trusted: whatever is drawn there, nothing shows it.
_ALONE = np.int8(2)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _sample(image, x, y):
    height, width = image.shape
    x = min(max(x, np.float32(0.0)), np.float32(width - 1.001))
    y = min(max(y, np.float32(0.0)), np.float32(height - 1.001))
    i, j = int(x), int(y)
    fx, fy = np.float32(x - i), np.float32(y - j)
    return (1 - fy) * ((1 - fx) * image[j, i] + fx * image[j, i + 1]) + fy * (
        (1 - fx) * image[j + 1, i] + fx * image[j + 1, i + 1]
    )


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _read_patch(image, x, y, step, out):
    """Fill `out` with the samples of the patch about (x, y)."""
    height, width = image.shape
    side = 2 * _PATCH + 1
    if not (step == 1 and _PATCH == 1 and x >= 1 and y >= 1 and x < width - 2 and y < height - 2):
        for k in range(side * side):
            out[k] = _sample(image, x + (k % side - _PATCH) * step, y + (k // side - _PATCH) * step)
        return
    # Samples a pixel apart share their weights, and most of their pixels.
    i, j = int(x) - 1, int(y) - 1
    fx, fy = np.float32(x - (i + 1)), np.float32(y - (j + 1))
    left = middle = right = np.float32(0.0)
    for v in range(4):
        a, b, c, d = image[j + v, i], image[j + v, i + 1], image[j + v, i + 2], image[j + v, i + 3]
        below_left, below, below_right = a + fx * (b - a), b + fx * (c - b), c + fx * (d - c)
        if v > 0:
            out[3 * v - 3] = left + fy * (below_left - left)
            out[3 * v - 2] = middle + fy * (below - middle)
            out[3 * v - 1] = right + fy * (below_right - right)
        left, middle, right = below_left, below, below_right


@njit(cache=True, nogil=True, error_model="numpy")
def _mismatch(image, centres, members, count, x, y, slope, radius, step, floor, nearest, patches, moments, costs):
    """How badly the better share of the views of the patch at (x, y) agrees with one of the most central ones."""
    size = (2 * _PATCH + 1) ** 2
    views = 0
    for m in range(count):
        lens = members[m]
        dx = -(x - centres[lens, 0]) * slope
        dy = -(y - centres[lens, 1]) * slope
        if m > 0 and dx * dx + dy * dy > radius * radius:
            continue
        px, py = centres[lens, 0] + dx, centres[lens, 1] + dy
        mean = squares = np.float32(0.0)
        _read_patch(image, px, py, step, patches[views])
        for k in range(size):
            value = patches[views, k]
            mean += value
            squares += value * value
        mean /= size
        moments[views, 0] = mean
        moments[views, 1] = max(squares / size - mean * mean, np.float32(0.0))
        views += 1
        if views > _MOST_VIEWS:
            break
    if views < 2:
        return _UNKNOWN
    least = np.float32(np.inf)
    share = _OPEN if nearest else _HALF
    half = max(1, int(share * (views - 1) + np.float32(0.5)))
    # An occluder may hide the place from the most central view as well.
    for r in range(min(_REFERENCES, views)):
        found = 0
        for m in range(views):
            if m == r:
                continue
            sdd = np.float32(0.0)
            for k in range(size):
                sdd += (patches[m, k] - patches[r, k]) ** 2
            apart = moments[r, 1] + moments[m, 1] + (moments[r, 0] - moments[m, 0]) ** 2
            cost = (sdd / size + _UNKNOWN * floor) / (apart + floor)
            # Insertion keeps the costs sorted.
            at = found
            while at > 0 and costs[at - 1] > cost:
                costs[at] = costs[at - 1]
                at -= 1
            costs[at] = cost
            found += 1
        best = np.float32(0.0)
        for m in range(half):
            best += costs[m]
        least = min(least, best / half)
    if not nearest and least > _UNKNOWN:
        least = _UNKNOWN + (least - _UNKNOWN) * views / (views + _HALF_VIEWS)
    return least


@njit(cache=True, nogil=True, error_model="numpy")
def _tried(
    image, centres, members, count, x, y, s, nudge, pitch, radius, step, floor, nearest, patches, moments, costs
):  # fmt: skip
    """The patch size among `s` and those a `nudge` beside it that matches best, and its mismatch."""
    best = s
    least = _mismatch(
        image, centres, members, count, x, y, s / pitch, radius, step, floor, nearest, patches, moments, costs
    )
    # What matches well needs no better value, and what is hidden in all views finds none.
    if nudge == 0 or least < _GOOD or least == _UNKNOWN:
        return best, least
    for turn in (-1, 1):
        value = s + turn * nudge
        mismatch = _NUDGED + _mismatch(
            image, centres, members, count, x, y, value / pitch, radius, step, floor, nearest, patches, moments, costs
        )
        if mismatch < least:
            best, least = value, mismatch
    return best, least


@njit(cache=True, nogil=True, error_model="numpy")
def _hide(depths, costs, pitch, evidence):
    """Raise the mismatch of each candidate by the evidence for a nearer one."""
    for k in range(len(depths)):
        evidence[k] = max(_MATCHED - costs[k], np.float32(0.0))
    for k in range(len(depths)):
        hidden = np.float32(0.0)
        for q in range(len(depths)):
            if nearness(depths[q], pitch) > nearness(depths[k], pitch):
                hidden = max(hidden, evidence[q])
        costs[k] += _HIDDEN * hidden


@njit(cache=True, nogil=True, inline="always")
def _lens_at(grid, low, i, j):
    ci, cj = i - low[0], j - low[1]
    if ci < 0 or cj < 0 or cj >= grid.shape[0] or ci >= grid.shape[1]:
        return -1
    return grid[cj, ci]


@njit(cache=True, nogil=True)
def _coprime_stride(n):
    """A step near the golden section of `n` that visits all of 0..n-1."""
    stride = max(1, int(0.618 * n))
    while True:
        a, b = n, stride
        while b:
            a, b = b, a % b
        if a == 1:
            return stride
        stride -= 1


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def calm_lenses(values, seconds, trust, indices, grid, low, ring, gap):
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


@njit(cache=True, nogil=True, inline="always")
def _all_settled(settled, grid, low, ring, i, j, lens):
    """Whether a lens is settled, or, beyond the last ones, all about its place are."""
    if lens >= 0:
        return settled[lens]
    for r in range(len(ring)):
        other = _lens_at(grid, low, i + ring[r, 0], j + ring[r, 1])
        if other >= 0 and not settled[other]:
            return False
    return True


# Python's error model checks every division, which no vector loop can.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _mean_around(count, there_x, there_y, sizes, trusts, x, y, vote2):
    """Weighted mean of the answers of the `count` lenses around a scene point."""
    weight = total = np.float32(0.0)
    per_vote2 = np.float32(1.0) / vote2
    for m in range(count):
        dx, dy = x - there_x[m], y - there_y[m]
        share = max(np.float32(1.0) - (dx * dx + dy * dy) * per_vote2, np.float32(0.0))
        w = trusts[m] * share * share
        weight += w
        total += w * sizes[m]
    return total / weight


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def propose(
    image, centres, radius, pitch, values, seconds, trust, calm, grid, low, origin, inverse, bend, bend_low, ring,
    gap, floor, first, spacing, vote2, step, settled, old, depths, costs,
):  # fmt: skip
    """Candidate depths of each scene point, from the lenses around it, in `depths`, their mismatch in `costs`.

    About lenses that are `settled` the only one is that of the `old` surface, which may else be (0, 0). Unused places
    are NaN. A point on whose depth all lenses around agree has one candidate, of cost 0.
    """
    rows, columns, most = depths.shape
    nearby = len(ring)
    zero = np.float32(0.0)
    # Contested places come in clusters: strides spread them over the threads.
    stride = _coprime_stride(rows)
    for row in prange(rows):
        v = row * stride % rows
        members = np.empty(nearby, np.int32)
        distance = np.empty(nearby, np.float32)
        sizes = np.empty((1 + seconds.shape[1]) * nearby, np.float32)
        weights = np.empty((1 + seconds.shape[1]) * nearby, np.float32)
        evidence = np.empty(most, np.float32)
        patches = np.empty((_MOST_VIEWS + 1, (2 * _PATCH + 1) ** 2), np.float32)
        moments = np.empty((_MOST_VIEWS + 1, 2), np.float32)
        sorted_costs = np.empty(_MOST_VIEWS, np.float32)
        # The lenses around that by which the last scene points lay, one after the other for a vector loop.
        around = 0
        around_i, around_j = 2**62, 0
        there_x, there_y = np.empty(nearby, np.float32), np.empty(nearby, np.float32)
        there_sizes, there_trust = np.empty(nearby, np.float32), np.empty(nearby, np.float32)
        for u in range(columns):
            x, y = np.float32(first + u * spacing), np.float32(first + v * spacing)
            for k in range(most):
                depths[v, u, k] = np.nan
                costs[v, u, k] = np.inf
            at_i, at_j = nearest_index(first + u * spacing, first + v * spacing, origin, inverse, bend, bend_low)
            i, j = int(at_i), int(at_j)
            lens = _lens_at(grid, low, i, j)
            if old.size > 0 and _all_settled(settled, grid, low, ring, i, j, lens):
                depths[v, u, 0], costs[v, u, 0] = old[v, u], 0.0
                continue
            if lens >= 0 and calm[lens]:
                if calm[lens] == _ALONE:
                    depths[v, u, 0] = values[lens]
                else:
                    if i != around_i or j != around_j:
                        around, around_i, around_j = 0, i, j
                        for r in range(nearby):
                            other = _lens_at(grid, low, i + ring[r, 0], j + ring[r, 1])
                            if other >= 0:
                                there_x[around], there_y[around] = centres[other, 0], centres[other, 1]
                                there_sizes[around], there_trust[around] = values[other], trust[other]
                                around += 1
                    depths[v, u, 0] = _mean_around(around, there_x, there_y, there_sizes, there_trust, x, y, vote2)
                costs[v, u, 0] = 0.0
                continue
            count = 0
            for r in range(nearby):
                lens = _lens_at(grid, low, i + ring[r, 0], j + ring[r, 1])
                if lens < 0:
                    continue
                d = (x - centres[lens, 0]) ** 2 + (y - centres[lens, 1]) ** 2
                at = count
                while at > 0 and distance[at - 1] > d:
                    distance[at], members[at] = distance[at - 1], members[at - 1]
                    at -= 1
                distance[at], members[at] = d, lens
                count += 1
            # Votes, sorted by patch size: every lens's answer, and its second best.
            votes = 0
            everyone = np.float32(0.0)
            for m in range(count):
                if distance[m] > vote2 and m > 0:
                    break
                lens = members[m]
                if m > 0 and trust[lens] < _TRUSTED:
                    continue
                w = trust[lens] * max(1 - distance[m] / vote2, np.float32(1e-3)) ** 2
                everyone += w
                for second in range(1 + seconds.shape[1]):
                    s = seconds[lens, second - 1] if second else values[lens]
                    if not np.isfinite(s):
                        continue
                    at = votes
                    while at > 0 and sizes[at - 1] > s:
                        sizes[at], weights[at] = sizes[at - 1], weights[at - 1]
                        at -= 1
                    sizes[at], weights[at] = s, _VOTES[second] * w
                    votes += 1
            # Clusters of votes are the candidates; the weightiest are kept.
            found = 0
            start = 0
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
                if found < most or weight > costs[v, u, most - 1]:
                    while at > 0 and costs[v, u, at - 1] < weight:
                        costs[v, u, at], depths[v, u, at] = costs[v, u, at - 1], depths[v, u, at - 1]
                        at -= 1
                    costs[v, u, at], depths[v, u, at] = weight, total / weight
                    found = min(found + 1, most)
                start = stop
            if found <= 1:
                costs[v, u, 0] = 0.0
                continue
            nearest = 0
            for k in range(1, found):
                if nearness(depths[v, u, k], pitch) > nearness(depths[v, u, nearest], pitch):
                    nearest = k
            for k in range(found):
                share = costs[v, u, k] / everyone
                depths[v, u, k], mismatch = _tried(
                    image, centres, members, count, x, y, depths[v, u, k], _NUDGE * gap if share < _ROUGH else zero,
                    pitch, radius, step, floor, k == nearest, patches, moments, sorted_costs,
                )  # fmt: skip
                costs[v, u, k] = mismatch + _PRIOR * max(zero, 1 - share)
            _hide(depths[v, u, :found], costs[v, u, :found], pitch, evidence)
