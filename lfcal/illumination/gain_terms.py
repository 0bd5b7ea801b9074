"""Terms of a gain map that follow from what a map leaves over: rim, cutting disc, shading, as far as they are sure."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..gain.gain_map import GainMap, count_terms, field_frame
from ..lattice.lattice import Lattice
from .residuals import DIRECTIONS, GainResiduals

__all__ = ["cut_terms", "field_monomials", "rim_terms", "shade_terms"]

# Harmonics of the rim: lens shapes, squares and hexagons with their corners; those that change over the field.
_HARMONICS, _CHANGING = 12, 3
_RIM_DEGREE, _SHADE_DEGREE = 2, 3
# A part of the model stays where it is so many times its standard error and moves a rim by so many px (RMS).
_SURE, _MATTERS = 4.0, 0.02


def field_monomials(points: NDArray[np.float64], lattice: Lattice, degree: int) -> NDArray[np.float64]:
    """(n, t) terms of a polynomial of the field at flat positions `points` (n, 2), in the order of `GainMap`."""
    middle_x, middle_y, reach = field_frame(lattice)
    x, y = ((points - (middle_x, middle_y)) / reach).T
    # As each degree follows from the one before: powers take far longer.
    table = np.empty((len(x), count_terms(degree)))
    table[:, 0] = 1.0
    for d in range(1, degree + 1):
        start, before = count_terms(d - 1), count_terms(d - 2)
        table[:, start : start + d] = table[:, before:start] * x[:, None]
        table[:, start + d] = table[:, start - 1] * y
    return table


def _significant(
    blocks: list[NDArray[np.float64]], target: NDArray[np.float64], weight: NDArray[np.float64], matters: float
) -> list[NDArray[np.float64]]:
    """Least-squares factors of the columns of each block, all zero for blocks that do not matter or are not sure."""
    table = np.hstack(blocks)
    root = np.sqrt(weight)[:, None]
    usable = int((weight > 0).sum())
    if usable <= 2 * table.shape[1]:
        return [np.zeros(b.shape[1]) for b in blocks]
    ends = np.cumsum([0] + [b.shape[1] for b in blocks])
    keep = np.ones(len(blocks), dtype=bool)
    factors = np.zeros(table.shape[1])
    for _ in range(2):
        columns = np.concatenate([np.arange(ends[k], ends[k + 1]) for k in np.flatnonzero(keep)] or [np.zeros(0, int)])
        factors[:] = 0
        if len(columns) == 0:
            break
        weighted = root * table[:, columns]
        covariance = np.linalg.pinv(weighted.T @ weighted, rcond=1e-10)
        factors[columns] = covariance @ (weighted.T @ (root[:, 0] * target))
        miss = root[:, 0] * (target - table @ factors)
        covariance *= float(miss @ miss) / (usable - len(columns))
        place = {int(c): k for k, c in enumerate(columns)}
        for k in np.flatnonzero(keep):
            own = np.arange(ends[k], ends[k + 1])
            at = [place[int(c)] for c in own]
            part = table[:, own] @ factors[own]
            size = math.sqrt(float(weight @ part**2) / float(weight.sum()))
            sure = factors[own] @ np.linalg.pinv(covariance[np.ix_(at, at)]) @ factors[own] / len(own)
            keep[k] = size > matters and sure > _SURE**2
    return [factors[a:b] for a, b in pairwise(ends)]


def rim_terms(left: GainResiduals, gain: GainMap, middle: NDArray[np.float64], lattice: Lattice) -> NDArray[np.float64]:
    """Polynomials of the rim after a pass; those of no significance are none."""
    parts = len(middle)
    # Window or direction without rim: no say.
    weight = left.rim_down.ravel()
    angle = np.tile(np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS, parts)
    degree = _RIM_DEGREE if parts > 2 * count_terms(_RIM_DEGREE) else 0
    field = np.repeat(field_monomials(middle, lattice, degree), DIRECTIONS, axis=0)
    old = np.zeros((1 + 2 * _HARMONICS, count_terms(degree)))
    old[: gain.rim.shape[0], : gain.rim.shape[1]] = gain.rim[:, : old.shape[1]]
    waves = [np.ones(len(angle))]
    for k in range(1, _HARMONICS + 1):
        waves += [np.cos(k * angle), np.sin(k * angle)]
    target = left.rim_up.ravel() / np.maximum(weight, 1e-30)
    rows: list[list[int]] = [[0]] + [[2 * k - 1, 2 * k] for k in range(1, _HARMONICS + 1)]
    blocks, where = [], []
    for k, pair in enumerate(rows):
        # The mean rim of the whole field is the profile's.
        columns = range(field.shape[1]) if k <= _CHANGING else range(1)
        cells = [(row, c) for row in pair for c in columns if not (k == 0 and c == 0)]
        if cells:
            blocks.append(np.column_stack([waves[row] * field[:, c] for row, c in cells]))
            where.append(cells)
    # What is already in the map is fitted again, so that it can be found to be of no significance.
    for block, cells in zip(blocks, where, strict=True):
        target = target + block @ np.array([old[cell] for cell in cells])
    factors = _significant(blocks, np.where(weight > 0, target, 0.0), weight, _MATTERS)
    rim = np.zeros_like(old)
    for values, cells in zip(factors, where, strict=True):
        for value, cell in zip(values, cells, strict=True):
            rim[cell] = value
    last = max([0] + [k for k in range(1, _HARMONICS + 1) if np.any(rim[2 * k - 1 : 2 * k + 1])])
    return rim[: 1 + 2 * last]


def cut_terms(left: GainResiduals, gain: GainMap) -> NDArray[np.float64]:
    """The cutting disc after a pass."""
    normal = left.cut_normal + np.tril(left.cut_normal, -1).T
    normal += 1e-6 * np.trace(normal) * np.eye(5) + 1e-12 * np.eye(5)
    radius, soft = gain.cut[3:]
    # Steps that a straight line cannot vouch for are shortened.
    most = np.array([1, 1, 1, 1, 0.3]) * soft
    cut = gain.cut + np.clip(np.linalg.solve(normal, left.cut_right), -most, most)
    cut[3], cut[4] = max(cut[3], 0.3 * radius), np.clip(cut[4], 0.2, 0.2 + 0.1 * radius)
    return cut


def shade_terms(
    left: GainResiduals, gain: GainMap, middle: NDArray[np.float64], lattice: Lattice
) -> NDArray[np.float64]:
    """Polynomials of the shading after a pass."""
    parts = len(middle)
    degree = _SHADE_DEGREE if parts > 2 * count_terms(_SHADE_DEGREE) else 1 if parts > 2 * count_terms(1) else 0
    field = field_monomials(middle, lattice, degree)
    shade = np.zeros((5, field.shape[1]))
    shade[:, : gain.shading.shape[1]] = gain.shading[:, : field.shape[1]]
    # The light of a window is a nuisance, the mean curvature is the profile's.
    own = np.maximum(left.normal[:, 5, 5], 1e-30)
    mixed = left.normal[:, :5, 5]
    normal = left.normal[:, :5, :5] - mixed[:, :, None] * mixed[:, None, :] / own[:, None, None]
    right = left.right[:, :5] - mixed * (left.right[:, 5] / own)[:, None]
    cells = [(row, c) for row in range(5) for c in range(field.shape[1] if row < 2 else min(6, field.shape[1]))]
    design = np.zeros((parts, 5, len(cells)))
    for k, (row, c) in enumerate(cells):
        design[:, row, k] = field[:, c]
    round_ = np.array([1.0 * (cell in ((2, 0), (4, 0))) for cell in cells])
    matter = np.einsum("wap,wab,wbq->pq", design, normal, design, optimize=True)
    force = np.einsum("wap,wa->p", design, right)
    matter += np.outer(round_, round_) * np.trace(matter) + (1e-9 * np.trace(matter) + 1e-12) * np.eye(len(cells))
    change = np.linalg.solve(matter, force)
    for value, cell in zip(change, cells, strict=True):
        shade[cell] += value
    return shade
