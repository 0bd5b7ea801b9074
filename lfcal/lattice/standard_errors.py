"""How well a lattice is known: standard errors of its parameters and centres, and residuals of
single microimages.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runtime.arrays import Floats, Frozen, Singles, decode_array, encode_array
from .lattice import Lattice

__all__ = ["LatticeErrors", "Residuals", "equal_weight_errors"]

_STRAIGHT_NAMES = ("origin", "origin", "a1", "a1", "a2", "a2")
_DISTORTION_NAMES = ("k1", "k2", "centre", "general")
# Unit of residuals in camera files [px]: finer than the noise of a single microimage.
_FILE_UNIT = 1e-3


@dataclass(frozen=True, eq=False)
class LatticeErrors(Frozen):
    """Covariance of the fitted parameters of a lattice.

    Parameters
    ----------
    names : tuple of p str
        `"origin"`, `"a1"`, `"a2"`, each for x and y [px]; then `"k1"`, `"k2"`, `"centre"` (twice,
        [px]) or `"general"` (14 times, [px]) as far as they were fitted.
    covariance : (p, p) float64

    Examples
    --------
    >>> import lfcal, lfrender
    >>> sample = lfrender.data.house(size=(400, 300), samples=2)
    >>> camera = lfcal.calibrate(sample.white, kind="white")
    >>> bool((camera.errors.of_centres(camera.lattice) < 0.1).all())
    True
    """

    names: tuple[str, ...]
    covariance: Floats

    def __post_init__(self) -> None:
        covariance = np.array(self.covariance, dtype=np.float64)
        if covariance.shape != (len(self.names),) * 2 or not np.isfinite(covariance).all():
            raise ValueError(
                f"covariance must be finite, one row per name, got shape {covariance.shape}"
            )
        if self.names[:6] != _STRAIGHT_NAMES or not set(self.names[6:]) <= set(_DISTORTION_NAMES):
            raise ValueError(f"names of fitted parameters are not known: {self.names}")
        self._set(covariance=covariance)

    @property
    def standard_errors(self) -> Floats:
        """(p,) standard errors of the parameters."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0))

    @property
    def condition(self) -> float:
        """Condition number of the fit, 1 and more; infinite where the parameters cannot be told
        apart.

        Of the least-squares design with columns of unit length, so that units and the number of
        lenses do not matter. A flat of 33 x 29 lenses has 1.6, a strip of 70 x 9 whose radial
        distortion is fitted as well has 18.
        """
        errors = self.standard_errors
        if not (errors > 0).all():
            return float("inf")
        # Unit columns are those of the design, so the information matrix is scaled, not the
        # covariance.
        information = np.linalg.pinv(self.covariance / np.outer(errors, errors))
        scale = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
        values = np.linalg.eigvalsh(information / np.outer(scale, scale))
        return float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else float("inf")

    def of_centres(self, lattice: Lattice) -> Floats:
        """(n,) standard errors [px] of the centres, in the order of `lattice.centres()`.

        Expected RMS distance of a centre from its true position, propagated from the covariance.
        """
        _, design = lattice.derivatives(lattice.indices(), self.names)
        spread = (design.reshape(-1, len(self.names)) @ self.covariance).reshape(design.shape)
        errors: Floats = np.sqrt(np.maximum((design * spread).sum((1, 2)), 0))
        return errors

    def scaled(self, block: float) -> LatticeErrors:
        """The errors in units of pixels smaller by the factor `block`."""
        unit = np.array([1.0 if name in ("k1", "k2") else block for name in self.names])
        return LatticeErrors(self.names, self.covariance * np.outer(unit, unit))

    def to_dict(self) -> dict[str, Any]:
        """As plain numbers and strings."""
        return {"names": list(self.names), "covariance": self.covariance.tolist()}

    @classmethod
    def from_dict(cls, data: Any) -> LatticeErrors:
        """From `to_dict`; KeyError, TypeError or ValueError where that is wrong."""
        return cls(
            tuple(str(name) for name in data["names"]),
            np.array(data["covariance"], dtype=np.float64),
        )


def equal_weight_errors(lattice: Lattice, uncertainty: float) -> LatticeErrors:
    """Errors of a straight lattice fitted to all its lenses with equal weights.

    `uncertainty` is the standard error of a centre, RMS over the flat [px].
    """
    index = lattice.indices()
    table = np.column_stack([np.ones(len(index)), index])
    per_axis: Floats = uncertainty**2 * len(index) / 6 * np.linalg.inv(table.T @ table)
    return LatticeErrors(
        _STRAIGHT_NAMES, np.asarray(np.kron(per_axis, np.eye(2)), dtype=np.float64)
    )


@dataclass(frozen=True, eq=False)
class Residuals(Frozen):
    """Centres measured on single microimages minus those of the fitted lattice.

    Parameters
    ----------
    indices : (n, 2) int32
        Lattice indices `i, j` of the microimages of the fit: those that lie entirely on the flat,
        or an even sample of them where they are very many.
    offset : (n, 2) float32 [px]
        From the lattice centre to the centre measured on this microimage alone, order `x, y`.

    Examples
    --------
    >>> import lfcal, lfrender
    >>> sample = lfrender.data.house(size=(400, 300), samples=2)
    >>> residuals = lfcal.calibrate(sample.white, kind="white").residuals
    >>> residuals.indices.shape == residuals.offset.shape
    True
    """

    indices: NDArray[np.int32]
    offset: Singles

    def __post_init__(self) -> None:
        indices = np.array(self.indices, dtype=np.int32)
        offset = np.array(self.offset, dtype=np.float32)
        if indices.ndim != 2 or indices.shape[1] != 2 or offset.shape != indices.shape:
            raise ValueError(
                f"residuals need two arrays (n, 2), got {indices.shape} and {offset.shape}"
            )
        self._set(indices=indices, offset=offset)

    def mean_over_grid(
        self, lattice: Lattice, across: int = 12, down: int = 9
    ) -> tuple[Floats, Floats, Floats]:
        """Mean residuals in a grid of rectangles of the flat, without outliers.

        Of each rectangle with two microimages or more: their mean centre (m, 2), mean residual (m,
        2) and the standard error of its length (m,), all in px.
        """
        centres = lattice.points(self.indices)
        share = (centres + 0.5) / np.array(lattice.image_size) * [across, down]
        column, row = np.clip(share.astype(int), 0, [across - 1, down - 1]).T
        length = np.hypot(*self.offset.T)
        inlier = length <= 4 * np.median(length) if len(length) else np.zeros(0, dtype=bool)
        rows = []
        for cell in range(across * down):
            inside = inlier & (row * across + column == cell)
            count = int(inside.sum())
            if count > 1:
                offset = self.offset[inside].astype(np.float64)
                error = np.sqrt(offset.var(0, ddof=1).sum() / count)
                rows.append((*centres[inside].mean(0), *offset.mean(0), error))
        table = np.array(rows).reshape(-1, 5)
        return table[:, :2], table[:, 2:4], table[:, 4]

    def scaled(self, block: float) -> Residuals:
        """The residuals in units of pixels smaller by the factor `block`."""
        return Residuals(self.indices, self.offset * np.float32(block))

    def to_dict(self) -> dict[str, Any]:
        """Two packed blocks; offsets to a thousandth of a pixel."""
        steps = np.clip(np.rint(self.offset / _FILE_UNIT), -32767, 32767)
        return {
            "indices": encode_array(self.indices.T.astype("<i2")),
            "offset": encode_array(steps.T.astype("<i2")),
        }

    @classmethod
    def from_dict(cls, data: Any) -> Residuals:
        """Rebuild from `to_dict`; KeyError, TypeError or ValueError where that is wrong."""
        indices, steps = (
            decode_array(data[name], "<i2").reshape(2, -1).T for name in ("indices", "offset")
        )
        return cls(indices.astype(np.int32), steps.astype(np.float32) * np.float32(_FILE_UNIT))
