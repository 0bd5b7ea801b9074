"""Shortcuts of an analysis, and the sparse samples of lenses that some of them need."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

__all__ = ["Shortcuts", "sample_lenses"]


@dataclass(frozen=True)
class Shortcuts:
    """Which shortcuts an analysis takes."""

    blank: bool = True  # lenses without texture are not matched
    ranges: bool = True  # most lenses are matched only near patch sizes that occur in a sparse sample of them
    still: bool = True  # lenses whose pixels equal those of the previous frame keep their depth
    steady: bool = True  # so do lenses that still match at the depth they had. Needs `still`

    @classmethod
    def of(cls, skip: bool | Iterable[str]) -> Shortcuts:
        """All, none, or those with the given names.

        Raises
        ------
        ValueError
            If there is no shortcut of such a name.
        """
        names = [field.name for field in fields(cls)]
        if isinstance(skip, str):
            skip = (skip,)
        wanted = names * skip if isinstance(skip, bool) else list(skip)
        unknown = [name for name in wanted if name not in names]
        if unknown:
            raise ValueError(f"skip must be True, False or some of {', '.join(names)}, got {unknown[0]!r}")
        return cls(**{name: name in wanted for name in names})


def sample_lenses(indices: NDArray[np.int64], candidates: NDArray[np.bool_], count: int) -> NDArray[np.bool_]:
    """(n,) bool: about `count` of the candidates, evenly spread and of all lens types; all where they are few.

    `indices` (n, 2) are those of all lenses on the lattice.
    """
    spacing = candidates.sum() / count
    if spacing < 2:
        return candidates
    i = _avoid_threes(int(np.sqrt(spacing)))
    return candidates & (indices % (i, _avoid_threes(int(spacing / i))) == 0).all(1)


def _avoid_threes(every: int) -> int:
    """`every`, but no multiple of three, which would sample only one lens type of multi-focus arrays."""
    return every - (every % 3 == 0)
