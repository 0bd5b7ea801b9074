"""What an analysis may leave out, and the lenses it looks at first to know."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

__all__ = ["Shortcuts", "sample_lenses"]


@dataclass(frozen=True)
class Shortcuts:
    """Which shortcuts an analysis may take.

    Parameters
    ----------
    blank : bool
        Lenses without texture are not matched.
    ranges : bool
        Most lenses are only matched at patch sizes that occur in a sparse sample of them.
    plane : bool
        A scene that is one plane is recognised from a sample of its lenses; the others are only checked.
    still : bool
        Lenses whose pixels are those of an earlier frame keep their answer.
    steady : bool
        So do those that show something else at the depth they had: they are only checked. None is without `still`.
    """

    blank: bool = True
    ranges: bool = True
    plane: bool = True
    still: bool = True
    steady: bool = True

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
    share = candidates.sum() / count
    if share < 2:
        return candidates
    i = _no_third(int(np.sqrt(share)))
    return candidates & (indices % (i, _no_third(int(share / i))) == 0).all(1)


def _no_third(every: int) -> int:
    """`every`, but no multiple of three: steps of it would hit only one lens type of multi-focus arrays."""
    return every - (every % 3 == 0)
