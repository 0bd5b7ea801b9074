"""The lenses in rings about each: beside it, or some steps off."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from .remembered import remembered

__all__ = ["afar", "around"]

# Two rings hold so many times the lenses of the first: of a lattice, the second has twice as many.
_BOTH_RINGS = 3
# Rings afar are so many steps apart: what lenses tell with two rings about them, others there hardly tell again.
_STEPS = 3


@njit(cache=True, nogil=True, parallel=True)
def _find_around(neighbours, out):
    """The neighbours of each lens and their neighbours, each once, then -1."""
    for lens in prange(len(out)):
        count = 0
        for k in range(neighbours.shape[1]):
            near = neighbours[lens, k]
            if near >= 0:
                out[lens, count] = near
                count += 1
        for k in range(neighbours.shape[1]):
            near = neighbours[lens, k]
            if near < 0:
                continue
            for m in range(neighbours.shape[1]):
                other = neighbours[near, m]
                new = other >= 0 and other != lens
                for seen in range(count):
                    new &= out[lens, seen] != other
                if new and count < out.shape[1]:
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
