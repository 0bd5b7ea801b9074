"""Neighbours of all lenses of a lattice, and the straight rows of lenses along which costs are
aggregated.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lfcal import Lattice
from lfcal.runtime.kernels import kernel

from ...flat.lens_graph import neighbour_rows
from ...runtime.cache import cached

__all__ = ["Neighbours", "neighbours_of"]


@kernel
def _follow(following, before, order, starts):
    """Fill `order` with all straight rows of lenses in turn, `starts` with the start of each;
    return their number.
    """
    count = chains = 0
    for first in range(len(following)):
        if before[first] >= 0:
            continue
        starts[chains] = count
        chains += 1
        lens = first
        while lens >= 0:
            order[count] = lens
            count += 1
            lens = following[lens]
    starts[chains] = count
    return chains


class Neighbours:
    """Rows of the neighbours of each lens, -1 where there is none.

    `all` (n, 2 d) has those in all directions, `forward` and `backward` (n, d) half of them each;
    `steps` (d, 2) are the mean steps forward [pitch], order `x, y`; `indices` (n, 2) those of the
    lenses on the lattice.
    """

    def __init__(self, lattice: Lattice) -> None:
        self.all: NDArray[np.int32] = neighbour_rows(lattice, lattice.steps)
        self.forward, self.backward = map(np.ascontiguousarray, np.split(self.all, 2, axis=1))
        self.indices = lattice.indices()
        centres = lattice.centres()
        mean = [
            (centres[row[row >= 0]] - centres[row >= 0]).sum(0) / max(1, (row >= 0).sum())
            for row in self.forward.T
        ]
        self.steps = (np.array(mean) / lattice.pitch).astype(np.float32)

    @cached_property
    def two_directions(self) -> NDArray[np.int32]:
        """(n, 2) the first directions forward: a third adds little."""
        return np.ascontiguousarray(self.forward[:, :2])

    @cached_property
    def chains(self) -> list[tuple[NDArray[np.int32], NDArray[np.int64]]]:
        """Straight rows of lenses, one after the other, and where each starts, in all directions."""
        found = []
        for ahead, behind in zip(
            self.all.T, np.hstack([self.backward, self.forward]).T, strict=True
        ):
            order = np.empty(len(ahead), np.int32)
            starts = np.empty(len(ahead) + 1, np.int64)
            count = _follow(
                np.ascontiguousarray(ahead), np.ascontiguousarray(behind), order, starts
            )
            found.append((order, starts[: count + 1].copy()))
        return found


def neighbours_of(lattice: Lattice) -> Neighbours:
    """Those of a lattice, made once."""
    return cached(lattice, "neighbours", lambda: Neighbours(lattice))
