"""Which lenses of a lattice are neighbours: tables that are built once for a lattice."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lfcal import Lattice

__all__ = ["Neighbours", "neighbours_of"]


class Neighbours:
    """Rows, in `lattice.centres()`, of the neighbours of each lens, -1 where there is none.

    `indices` (n, 2) are those of the lenses on the lattice. `grid` (nj, ni) holds the row of lens
    `(i, j)` at `[j - low[1], i - low[0]]`. No array may be written into.
    """

    def __init__(self, lattice: Lattice) -> None:
        self.indices = lattice.indices()
        self.low: NDArray[np.int64] = self.indices.min(0)
        across, down = self.indices.max(0) - self.low + 1
        self.grid = np.full((down, across), -1, np.int32)
        i, j = (self.indices - self.low).T
        self.grid[j, i] = np.arange(len(self.indices), dtype=np.int32)
        self._nearest = lattice.steps
        self._centres = lattice.centres()
        self._pitch = lattice.pitch

    def rows(self, steps: NDArray[np.int64]) -> NDArray[np.int32]:
        """(n, k) rows of the lenses `steps` (k, 2) index steps from each lens."""
        # With a border of -1 as wide as the longest step no look-up leaves the grid.
        border = int(np.abs(steps).max(initial=0))
        grid = np.pad(self.grid, border, constant_values=-1)
        width = grid.shape[1]
        i, j = (self.indices - self.low + border).T
        here = j * width + i
        return grid.ravel()[here[:, None] + (steps[:, 1] * width + steps[:, 0])]

    @cached_property
    def all(self) -> NDArray[np.int32]:
        """(n, 2 d) the nearest neighbours in all directions."""
        return self.rows(self._nearest)

    @cached_property
    def forward(self) -> NDArray[np.int32]:
        """(n, d) the first half of `all`."""
        return np.ascontiguousarray(self.all[:, : self.all.shape[1] // 2])

    @cached_property
    def backward(self) -> NDArray[np.int32]:
        """(n, d) the second half of `all`, opposite to the first."""
        return np.ascontiguousarray(self.all[:, self.all.shape[1] // 2 :])

    @cached_property
    def two_directions(self) -> NDArray[np.int32]:
        """(n, 2) the first directions forward: a third adds little."""
        return np.ascontiguousarray(self.forward[:, :2])

    @cached_property
    def steps(self) -> NDArray[np.float32]:
        """(d, 2) mean steps forward, `x, y` [pitch]."""
        mean = []
        for rows in self.forward.T:
            known = rows >= 0
            steps = self._centres[rows[known]] - self._centres[known]
            mean.append(steps.sum(0) / max(1, known.sum()))
        return (np.array(mean) / self._pitch).astype(np.float32)

    @cached_property
    def chains(self) -> list[tuple[NDArray[np.int32], NDArray[np.int64]]]:
        """Straight rows of lenses in all directions, and where each of them starts."""
        forward = []
        backward = []
        for (across, down), ahead in zip(self._nearest, self.forward.T, strict=False):
            i, j = self.indices.T
            order = np.lexsort((i * across + j * down, i * down - j * across)).astype(np.int32)
            starts = np.flatnonzero(ahead[order[:-1]] != order[1:]) + 1
            starts = np.concatenate([[0], starts, [len(order)]])
            forward.append((order, starts))
            backward.append((order[::-1].copy(), len(order) - starts[::-1]))
        return forward + backward

    @cached_property
    def two_rings(self) -> NDArray[np.int32]:
        """(n, 6 d) the lenses in two rings about each, the nearest first."""
        return self.rows(self._two_ring_steps())

    @cached_property
    def distant_rings(self) -> NDArray[np.int32]:
        """`two_rings` of every third lens, whose estimates are nearly independent of those of the
        nearest two rings.
        """
        return self.rows(3 * self._two_ring_steps())

    def _two_ring_steps(self) -> NDArray[np.int64]:
        """(6 d, 2) index steps to the nearest lenses, and from these to theirs."""
        nearest = self._nearest
        beyond = (nearest[:, None] + nearest).reshape(-1, 2)
        steps = np.concatenate([nearest, beyond[beyond.any(1)]])
        _, first = np.unique(steps, axis=0, return_index=True)
        return steps[np.sort(first)]


def neighbours_of(lattice: Lattice) -> Neighbours:
    """Those of a lattice, made once."""
    return lattice.derived(Neighbours)
