"""Types of microlenses in a multi-focus array: the focus of each type, and its blur."""

from __future__ import annotations

from dataclasses import dataclass, fields
from reprlib import repr as brief
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..runtime.arrays import Frozen
from ..runtime.errors import check_number, check_numbers

__all__ = ["LensBlur", "LensTypes"]

# Largest side of a repeating cell [lenses]: twice that of any known camera; types fit in int8.
_LARGEST_CELL = 16
# Largest size of a figure of blur [px, s / D]; discs of a camera have some px.
_LARGEST = 1e9


@dataclass(frozen=True, eq=False)
class LensTypes(Frozen):
    """The type of each microlens, as a cell that repeats over the lattice.

    If `ordered`, type 0 is focused at the largest patch size `|s|`, that is at the smallest virtual
    depth (nearest to the microlenses), and the last type at the smallest `|s|`.

    Parameters
    ----------
    cell : (m, m) int
        Lens `(i, j)` is of type `cell[i % m, j % m]`; types are numbered from 0 without gaps.
    ordered : bool
        True if types are numbered in the order of their focus, False if in any order.
    focus : (count,) float
        Signed patch size over the pitch, `s / D`, at which each type is sharpest; NaN if unknown.
    confidence : float
        0..1, by how much this pattern explains differences of sharpness better than others do.

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
        side = np.size(given, 0) if given.ndim else 0
        if given.shape != (side, side) or not 1 <= side <= _LARGEST_CELL:
            raise ValueError(
                f"cell of lens types must be (m, m) with m from 1 to {_LARGEST_CELL}, got "
                f"{given.shape}"
            )
        if given.dtype.kind not in "iu" or set(given.flat) != set(range(given.max() + 1)):
            raise ValueError(
                f"lens types must be numbered 0, 1, 2 ... without gaps, got {given.tolist()}"
            )
        count = int(given.max()) + 1
        focus = np.full(count, np.nan) if self.focus is None else check_numbers(self.focus, "focus")
        if focus.shape != (count,) or np.isinf(focus).any():
            raise ValueError(
                f"focus must be one number or NaN for each of {count} types, got {self.focus!r}"
            )
        if not 0 <= check_number(self.confidence, "confidence") <= 1:
            raise ValueError(
                f"confidence of lens types must be from 0 to 1, got {self.confidence!r}"
            )
        cell = given.astype(np.int8)
        confidence = float(self.confidence)
        self._set(cell=cell, focus=focus, ordered=bool(self.ordered), confidence=confidence)

    @property
    def count(self) -> int:
        """Number of types."""
        return int(self.cell.max()) + 1

    def of(self, indices: ArrayLike) -> NDArray[np.int8]:
        """(n,) int8 types of the lenses with lattice indices `i, j` (n, 2), on or off the flat."""
        index = np.asarray(indices)
        if index.dtype.kind not in "iu" or index.shape[-1:] != (2,):
            raise ValueError(
                f"indices must be whole numbers (n, 2), got {index.dtype} {index.shape}"
            )
        i, j = np.moveaxis(index % len(self.cell), -1, 0)
        return self.cell[i, j]

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, as in a camera file."""
        assert self.focus is not None
        focus = [None if np.isnan(f) else f for f in self.focus.tolist()]
        return {
            "count": self.count,
            "cell": self.cell.tolist(),
            "ordered": self.ordered,
            "focus": focus,
            "confidence": self.confidence,
        }

    @classmethod
    def from_dict(cls, data: Any) -> LensTypes:
        """Rebuild from `to_dict`; KeyError, TypeError or ValueError if a field is wrong."""
        focus = np.array([np.nan if f is None else float(f) for f in data["focus"]])
        return cls(np.array(data["cell"]), data["ordered"], focus, float(data["confidence"]))


@dataclass(frozen=True, eq=False)
class LensBlur(Frozen):
    """The disc over which each type of microlens blurs, at any depth.

    A microlens with the aperture `A` that is in focus at `s / D = f` blurs a point of patch size
    `s` over a disc with the diameter `A |s / D - f|`. The rims of microimages are images of the
    pupil of the main lens, which lies at `s = 0`; their blur is the disc there.

    Parameters
    ----------
    aperture, aperture_error : float [px]
        Diameter `A` of a microlens and its standard error.
    focus, focus_error : (types,) float64 [s / D]
        `s / D` at which each type is in focus, `f`.
    ratios : (depths,) float64
        `s / D` at which discs were measured; 0 for rims.
    discs, disc_errors : (types, depths) float64 [px]
        Diameters of the discs and their standard errors.

    Examples
    --------
    >>> rims = LensBlur(6.0, 1.2, [0.1], [0.1], [0.0], [[0.6]], [[0.2]])
    >>> discs, errors = rims.at([-0.3, 0.1])
    >>> discs.round(2), errors.round(2)
    (array([[2.4, 0. ]]), array([[0.41, 0.23]]))
    """

    aperture: float
    aperture_error: float
    focus: NDArray[np.float64]
    focus_error: NDArray[np.float64]
    ratios: NDArray[np.float64]
    discs: NDArray[np.float64]
    disc_errors: NDArray[np.float64]

    def __post_init__(self) -> None:
        aperture = check_number(self.aperture, "aperture")
        error = check_number(self.aperture_error, "aperture_error")
        if not 0 < aperture <= _LARGEST or not 0 <= error <= _LARGEST:
            raise ValueError(f"aperture of the microlenses must be positive, got {self.aperture!r}")
        self._set(aperture=aperture, aperture_error=error)
        focus = (np.size(self.focus),)
        ratios = (np.size(self.ratios),)
        shapes: dict[str, tuple[int, ...]] = {
            "focus": focus,
            "focus_error": focus,
            "ratios": ratios,
        }
        shapes |= dict.fromkeys(("discs", "disc_errors"), focus + ratios)
        for name, shape in shapes.items():
            values = check_numbers(getattr(self, name), name)
            least = 0 if name == "disc_errors" else -_LARGEST
            if values.shape != shape or not ((least < values) & (values < _LARGEST)).all():
                raise ValueError(
                    f"{name} of the blur must be {shape} finite numbers, errors positive, got "
                    f"{brief(values.tolist())}"
                )
            self._set(**{name: values})

    @property
    def tells_aperture(self) -> bool:
        """Whether the error of the aperture is below half of it; rims alone do not tell it."""
        return self.aperture_error < self.aperture / 2

    def at(self, ratios: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(types, n) diameters of the discs at these `s / D` (n,), and their standard errors [px].

        Each disc is extrapolated with the aperture from the measured disc that gives the smallest
        error.
        """
        wanted = check_numbers(ratios, "ratios")
        away = wanted - self.ratios[:, None]
        known = self.discs * np.sign(self.ratios - self.focus[:, None])
        discs = known[..., None] + self.aperture * away
        errors = np.hypot(self.disc_errors[..., None], self.aperture_error * away)
        nearest = errors.argmin(1)[:, None]
        found = np.take_along_axis(discs, nearest, 1)[:, 0]
        return np.abs(found), np.take_along_axis(errors, nearest, 1)[:, 0]

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, as in a camera file."""
        return {name: np.asarray(value).tolist() for name, value in vars(self).items()}

    @classmethod
    def from_dict(cls, data: Any) -> LensBlur:
        """Rebuild from `to_dict`; KeyError, TypeError or ValueError if a field is wrong."""
        return cls(**{field.name: data[field.name] for field in fields(cls)})
