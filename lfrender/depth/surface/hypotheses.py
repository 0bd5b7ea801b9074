"""Depth hypotheses of each scene point, from the lenses around it, and the mismatch of each on the pixels."""

from __future__ import annotations

from collections import namedtuple

import numpy as np
from numba import njit

from lfcal.runtime.kernels import kernel

from ...flat.distorted_lookup import nearest_index
from ..depth_order import depth_order
from ..same_surface import same_surface
from .photoconsistency import MAX_VIEWS, view_mismatch
from .scene_grid import SceneGrid, lens_at
from .settings import SURFACE, SurfaceSettings
from .votes import cluster_votes, find_central, find_voters, gather_table, mean_around, sort_votes

__all__ = ["MAX_HYPOTHESES", "hypothesis_constants", "propose_hypotheses"]

#: Hypotheses of one scene point, at most.
MAX_HYPOTHESES = 5

# Float32 values of `SurfaceSettings`, the tolerance of one surface and the pitch [px], the squared distance within
# which lenses vote [px^2], the radius of a microimage [px], and the mismatch `floor` that noise explains.
HypothesisConstants = namedtuple(
    "HypothesisConstants",
    "occluded_cost second_weight unvoted_cost unknown occluded_views gap pitch vote2 radius floor",
)  # fmt: skip


def hypothesis_constants(
    gap: float, pitch: float, voting_reach: float, radius: float, floor: float, settings: SurfaceSettings = SURFACE
) -> HypothesisConstants:
    """Values for `propose_hypotheses`: tolerance of one surface, pitch, and distance within which lenses vote [px]."""
    named = [getattr(settings, name) for name in HypothesisConstants._fields[:5]]
    return HypothesisConstants._make(map(np.float32, (*named, gap, pitch, voting_reach**2, radius, floor)))


@njit(error_model="numpy")
def _add_occlusion(depths, costs, matches, c):
    """Raise the cost of each hypothesis by how well a nearer one matches: past the edge of the nearer surface the one
    behind it matches as well."""
    count = len(depths)
    for k in range(count):
        matches[k] = max(c.unknown - costs[k], np.float32(0.0))
    for k in range(count):
        nearer = np.float32(0.0)
        for q in range(count):
            if depth_order(depths[q], c.pitch) > depth_order(depths[k], c.pitch):
                nearer = max(nearer, matches[q])
        costs[k] += c.occluded_cost * nearer


@njit(error_model="numpy")
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


@njit(error_model="numpy")
def _measure_mismatch(image, near_x, near_y, c, central, x, y, everyone, depths, costs, samples, views):
    """Turn the weights of hypotheses in `costs`, out of `everyone`, into their mismatch plus the price of few votes."""
    nearest = 0
    for k in range(len(depths)):
        if depth_order(depths[k], c.pitch) > depth_order(depths[nearest], c.pitch):
            nearest = k
    for k in range(len(depths)):
        cost, seen = view_mismatch(
            image, near_x, near_y, central, x, y, depths[k] / c.pitch, c.radius, c.floor, c.unknown, samples, views
        )
        if k != nearest and cost > c.unknown:
            # Behind another depth, where views may be occluded, a mismatch tells less.
            cost = c.unknown + (cost - c.unknown) * np.float32(seen) / (np.float32(seen) + c.occluded_views)
        costs[k] = cost + c.unvoted_cost * max(np.float32(0.0), 1 - costs[k] / everyone)


@kernel(error_model="numpy", share=lambda *given: given[9].shape[1])
def propose_hypotheses(
    begin, end, image, table, around, ring, agreeing, grid: SceneGrid, constants: HypothesisConstants, wanted, coarse,
    depths, costs,
):  # fmt: skip
    """Depth hypotheses of each `wanted` scene point in `depths`, their cost in `costs`, both (most, rows, columns).

    A point on whose depth all lenses around agree has one hypothesis; the place after the last one stays NaN; places
    beyond, and the costs of single hypotheses, are left as they are.

    Parameters
    ----------
    image : (H, W) float32
    table : (n, 6) float32
        Centre of each lens, its weight, and its patch size, second-best one and that of the second layer.
    around : (n, k) int32
        Rows of the lenses of `ring` (k, 2) about each.
    agreeing : (n,) bool
        Lenses around which all have one depth.
    grid : SceneGrid
    constants : HypothesisConstants
    wanted : (rows, columns) bool
    coarse : (rows / 2, columns / 2) float32
        Surface of twice the spacing: only hypotheses that one of its values about a point has are kept; (0, 0) if there
        is none.
    """
    most, _, columns = depths.shape
    c, gap = constants, constants.gap
    votes = np.float32(1.0), c.second_weight, np.float32(1.0)
    most_near, known = len(ring), table.shape[1]
    # Arrays are taken out of the tuple once: each access counts references.
    first, spacing, lookup, low = grid.first, grid.spacing, grid.rows, grid.low
    origin, inverse, bend, bend_low = grid.origin, grid.inverse, grid.bend, grid.bend_low
    for v in range(begin, end):
        nearby, distance = np.empty((known, most_near), np.float32), np.empty(most_near, np.float32)
        voters, shares = np.empty(most_near, np.int64), np.empty(most_near, np.float32)
        sizes, weights = np.empty(known * most_near, np.float32), np.empty(known * most_near, np.float32)
        near_x, near_y = np.empty(MAX_VIEWS, np.float32), np.empty(MAX_VIEWS, np.float32)
        own, prices, matches = np.empty(most, np.float32), np.empty(most, np.float32), np.empty(most, np.float32)
        central, views = np.empty(MAX_VIEWS, np.int64), np.empty(MAX_VIEWS, np.float32)
        samples = np.empty((MAX_VIEWS, 11), np.float32)
        count = 0
        around_i, around_j = 2**62, 0
        for u in range(columns):
            if not wanted[v, u]:
                continue
            x, y = first + u * spacing, first + v * spacing
            at_i, at_j = nearest_index(x, y, origin, inverse, bend, bend_low)
            i, j = int(at_i), int(at_j)
            lens = lens_at(lookup, low, i, j)
            # Consecutive points mostly lie in the cell of one lens.
            if i != around_i or j != around_j:
                count = gather_table(table, around, lookup, low, ring, i, j, lens, nearby)
                around_i, around_j = i, j
            px, py = np.float32(x), np.float32(y)
            if lens >= 0 and agreeing[lens]:
                depths[0, v, u] = mean_around(nearby, count, px, py, c.vote2)
                continue
            found, apart = find_voters(nearby, count, px, py, c.vote2, distance, voters, shares)
            if found == 0 or apart <= gap:
                depths[0, v, u] = mean_around(nearby, count, px, py, c.vote2)
                continue
            everyone = shares[:found].sum()
            number = sort_votes(nearby, found, voters, shares, votes, sizes, weights)
            found = cluster_votes(number, sizes, weights, gap, own, prices)
            if coarse.size > 0:
                found = _keep_coarse(coarse, v, u, gap, own, prices, found)
            if found > 1:
                shown = find_central(nearby, count, distance, central, near_x, near_y)
                _measure_mismatch(
                    image, near_x, near_y, c, shown, px, py, everyone, own[:found], prices[:found], samples, views
                )
                _add_occlusion(own[:found], prices[:found], matches, c)
                for k in range(1, found):
                    depths[k, v, u], costs[k, v, u] = own[k], prices[k]
                if found < most:
                    depths[found, v, u] = np.nan
                costs[0, v, u] = prices[0]
            depths[0, v, u] = own[0]
