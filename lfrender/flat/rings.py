"""The lenses in rings about each: beside it, or some steps off."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ..runtime.cache import remembered

__all__ = ["afar", "around"]

# Two rings hold so many times the lenses of the first: of a lattice, the second has twice as many.
_BOTH_RINGS = 3
# Rings afar are so many steps apart: what lenses tell with two rings about them, others there hardly tell again.
_STEPS = 3


@njit(cache=True, nogil=True)
def _find_one(neighbours, lens, ways, out):
    """Put the neighbours of a lens and their neighbours in `out`, each once, then -1, and the `ways` there, by which
    neighbour of which neighbour, in the first two columns; returns how many there are."""
    count = 0
    for k in range(neighbours.shape[1]):
        near = neighbours[lens, k]
        if near >= 0:
            out[count] = near
            count += 1
    for k in range(neighbours.shape[1]):
        near = neighbours[lens, k]
        if near < 0:
            continue
        for m in range(neighbours.shape[1]):
            other = neighbours[near, m]
            new = other >= 0 and other != lens
            for seen in range(count):
                new &= out[seen] != other
            if new and count < len(out):
                out[count], ways[count, 0], ways[count, 1] = other, k, m
                count += 1
    out[count:] = -1
    return count


@njit(cache=True, nogil=True, parallel=True)
def _find_around(neighbours, out):
    """As `_find_one` for each lens. On a lattice the ways are the same for all lenses that have all their neighbours;
    others that they do not lead to are left out."""
    most, near = out.shape[1], neighbours.shape[1]
    ways, known = np.empty((most, 2), np.int64), False
    for lens in range(len(out)):
        if (neighbours[lens] >= 0).all() and _find_one(neighbours, lens, ways, out[lens]) == most:
            known = True
            break
    for lens in prange(len(out)):
        whole = known
        for k in range(near):
            whole &= neighbours[lens, k] >= 0
        if not whole:
            _find_one(neighbours, lens, np.empty((most, 2), np.int64), out[lens])
            continue
        out[lens, :near] = neighbours[lens]
        count = near
        for n in range(near, most):
            other = neighbours[neighbours[lens, ways[n, 0]], ways[n, 1]]
            if other >= 0:
                out[lens, count] = other
                count += 1
        out[lens, count:] = -1


@njit(cache=True, nogil=True, parallel=True)
def _go_on(neighbours, steps, out):
    """The lenses so many steps from each in the directions of its neighbours, -1 where the way there is broken."""
    for lens in prange(len(out)):
        for k in range(neighbours.shape[1]):
            at = np.int32(lens)
            for _ in range(steps):
                at = neighbours[at, k] if at >= 0 else at
            out[lens, k] = at


def around(neighbours: NDArray[np.int32]) -> NDArray[np.int32]:
    """(n, 3 k) int32 rows of the lenses in two rings about each, -1 where there is none."""

    def find() -> NDArray[np.int32]:
        out = np.empty((len(neighbours), _BOTH_RINGS * neighbours.shape[1]), np.int32)
        _find_around(neighbours, out)
        return out

    return remembered(neighbours, "two rings", find)


def afar(neighbours: NDArray[np.int32]) -> NDArray[np.int32]:
    """As `around`, of rings three steps apart: the lenses three and six steps off."""

    def find() -> NDArray[np.int32]:
        far = np.empty_like(neighbours)
        _go_on(neighbours, _STEPS, far)
        return around(far)

    return remembered(neighbours, "two rings afar", find)
