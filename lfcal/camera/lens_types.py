"""Types of microlenses in a multi-focus array: the type of each lens, and the focus of each type."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..runtime.arrays import Frozen

__all__ = ["LensTypes"]

# Side of the largest repeating cell [lenses]: twice what cameras have had, and types fit in int8.
_LARGEST_CELL = 16


@dataclass(frozen=True, eq=False)
class LensTypes(Frozen):
    """The type of each microlens, as a cell that repeats over the lattice.

    If `ordered`, type 0 is focused at the largest patch size `|s|`, that is at the smallest virtual depth (nearest to
    the microlenses), and the last type at the smallest `|s|`.

    Parameters
    ----------
    cell : (m, m) int
        Lens `(i, j)` is of type `cell[i % m, j % m]`; types are numbered from 0 without gaps.
    ordered : bool
        Types are in the order of their focus; else their numbers have no meaning.
    focus : (count,) float
        Signed patch size over the pitch, `s / D`, at which each type is sharpest; NaN where not known.
    confidence : float
        0..1, how far this pattern exceeds other repeating patterns in sharpness differences.

    Examples
    --------
    >>> LensTypes([[0, 2, 1], [1, 0, 2], [2, 1, 0]]).of([(0, 0), (4, 0), (0, 1)])
    array([0, 1, 2], dtype=int8)
    """

    cell: NDArray[np.int8]
    ordered: bool = False
    focus: NDArray[np.float64] | None = None
    confidence: float = 1.0

    def __post_init__(self) -> None:
        given = np.asarray(self.cell)
        if given.ndim != 2 or given.shape[0] != given.shape[1] or not 1 <= len(given) <= _LARGEST_CELL:
            raise ValueError(f"cell of lens types must be (m, m) with m from 1 to {_LARGEST_CELL}, got {given.shape}")
        if given.dtype.kind not in "iu" or not np.array_equal(np.unique(given), np.arange(given.max() + 1)):
            raise ValueError(f"lens types must be numbered 0, 1, 2 ... without gaps, got {given.tolist()}")
        count = int(given.max()) + 1
        focus = np.full(count, np.nan) if self.focus is None else np.array(self.focus, dtype=np.float64)
        if focus.shape != (count,) or np.isinf(focus).any():
            raise ValueError(f"focus must be one number or NaN for each of {count} types, got {self.focus!r}")
        if not 0 <= self.confidence <= 1:
            raise ValueError(f"confidence of lens types must be from 0 to 1, got {self.confidence!r}")
        self._set(
            cell=given.astype(np.int8), focus=focus, ordered=bool(self.ordered), confidence=float(self.confidence)
        )

    @property
    def count(self) -> int:
        """Number of types."""
        return int(self.cell.max()) + 1

    def of(self, indices: ArrayLike) -> NDArray[np.int8]:
        """(n,) int8 types of the lenses with lattice indices `i, j` (n, 2), also beyond the flat."""
        index = np.asarray(indices)
        if index.dtype.kind not in "iu" or index.shape[-1:] != (2,):
            raise ValueError(f"indices must be whole numbers (n, 2), got {index.dtype} {index.shape}")
        i, j = np.moveaxis(index % len(self.cell), -1, 0)
        return self.cell[i, j]

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, as in a camera file."""
        assert self.focus is not None
        return {
            "count": self.count,
            "cell": self.cell.tolist(),
            "ordered": self.ordered,
            "focus": [None if np.isnan(f) else f for f in self.focus.tolist()],
            "confidence": self.confidence,
        }

    @classmethod
    def from_dict(cls, data: Any) -> LensTypes:
        """Rebuild from `to_dict`; KeyError, TypeError or ValueError where that is wrong."""
        focus = [float("nan") if f is None else float(f) for f in data["focus"]]
        return cls(np.array(data["cell"]), data["ordered"], np.array(focus), float(data["confidence"]))
