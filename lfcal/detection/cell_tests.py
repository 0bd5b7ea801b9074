"""Whether an average cell can be a microimage: what repeats in two directions is not always an array of lenses.

Light behind a lens depends on two lengths only: how far it falls from the centre of the microimage, and how far from
the border to the next one. Bricks, windows and cloth depend on more, gratings and waves on less.
"""

from __future__ import annotations

from math import gcd

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import CalibrationError
from .folding import TileFolds

__all__ = ["check_cell", "check_waves", "explained_by", "lengths_of"]

_RAW = "give a raw flat from the sensor, of a camera with a microlens array"
# Energy of the average cell that must lie beside the strongest line of harmonics: stripes have none there, touching
# lenses twice as long as wide a twentieth.
_TWO_WAYS = 0.04
# Least share of the average cell, apart from noise, that the two lengths explain, and light variation (standard
# deviation over mean) from which on it shows them: of flattened scene captures only the breaks are left.
_EXPLAINED = 0.8
# A scene of one kind all over the flat leaves some of itself in the average of a thousand lenses.
_EXPLAINED_SCENE = 0.65
# Where less energy than this lies beside one line, rows stand out, as they do in print: nearly all must be explained.
_LOPSIDED, _EXPLAINED_ROWS = 0.1, 0.93
_VISIBLE = 0.05
# Least energy of light beyond the first harmonics. Discs have a twentieth; only a blur of a seventh of the pitch leaves
# so little of it. Below so many pixels such a blur can be the sensor's, and waves get the benefit of the doubt.
_HARMONICS = 5e-3
_SHARP_PITCH = 10.0
# Finer harmonics than two pixels are aliases of coarser ones.
_SHORTEST_HARMONIC = 2.2
_HIGHEST = 6
_LENGTHS = 16
_AROUND = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])


def check_cell(
    cells: list[NDArray[np.float64]],
    light: NDArray[np.float64],
    tone: TileFolds,
    centre: NDArray[np.float64],
    repeatability: float,
) -> CalibrationError | None:
    """CalibrationError where the average cell cannot be that of microimages; returned where a scene may be the cause.

    Parameters
    ----------
    cells : list of (bins, bins) float64
        Average cell of each feature; bin `k` covers `[k, k + 1) / bins`.
    light : (bins, bins) float64
        Average cell of the light itself.
    tone : TileFolds
        Square root of the light on the reduced lattice, with bins far smaller than a pixel.
    centre : (2,) float64
        Microimage centre in fractional lattice coordinates.
    repeatability : float
        Correlation of the average cells of two halves of the flat.
    """
    basis = tone.basis
    beside = _beside_one_line(np.mean([_power(cell) for cell in cells], axis=0))
    if beside < _TWO_WAYS:
        raise CalibrationError(f"stripes repeat on the image, in one direction only; {_RAW}")
    pitch = float(np.sqrt(abs(np.linalg.det(basis))))
    if light.std() > _VISIBLE * light.mean():
        # What one half has in common with the other limits what any model can explain of their mean.
        possible = 2 * repeatability / (1 + repeatability)
        lengths = _lengths(basis, len(light), centre)
        explained = float(np.mean([_explained(cell, lengths) for cell in cells]))
        if explained < (_EXPLAINED if beside > _LOPSIDED else _EXPLAINED_ROWS) * possible:
            error = CalibrationError(f"a pattern repeats every {pitch:.1f} px that has no microimages; {_RAW}")
            if explained < _EXPLAINED_SCENE * possible:
                raise error
            return error
    return None


def check_waves(tone: TileFolds) -> None:
    """CalibrationError where the average cell, as for `check_cell`, has no edge that light behind a lens would have."""
    pitch = float(np.sqrt(abs(np.linalg.det(tone.basis))))
    if pitch > _SHARP_PITCH and _beyond_first(tone) < _HARMONICS:
        raise CalibrationError(f"crossed waves without any edge repeat every {pitch:.1f} px, not microimages; {_RAW}")


def _power(cell: NDArray[np.float64]) -> NDArray[np.float64]:
    """(bins, bins) shares of the variance by harmonic `[k, h]`."""
    energy = np.abs(np.fft.fft2(cell - cell.mean())) ** 2
    shares: NDArray[np.float64] = energy / max(float(energy.sum()), 1e-30)
    return shares


def _orders(bins: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Harmonics `h, k` of the bins of a transform."""
    order = np.rint(np.fft.fftfreq(bins) * bins).astype(int)
    k, h = np.meshgrid(order, order, indexing="ij")
    return h, k


def _beside_one_line(power: NDArray[np.float64]) -> float:
    """Share of the energy that is not on the strongest line of harmonics through zero."""
    h, k = _orders(len(power))
    lines = [(a, b) for a in range(4) for b in range(-3, 4) if gcd(a, b) == 1]
    return 1 - max(float(power[h * b == k * a].sum()) for a, b in lines)


def _beyond_first(tone: TileFolds) -> float:
    """Share of the energy of the light in harmonics that are not first ones in both directions."""
    total, count = (v.sum(0, dtype=np.float64) for v in (tone.total, tone.count))
    light = total**2 / np.maximum(count, 1)
    # Deviations weighted with their pixels: where the pitch is a whole number of pixels most bins are empty.
    power = np.abs(np.fft.fft2(light - light.sum() / count.sum() * count)) ** 2
    h, k = _orders(tone.bins)
    most = np.clip(np.hypot(*tone.basis.T) / _SHORTEST_HARMONIC, 1, _HIGHEST)
    power *= (abs(h) <= most[0]) & (abs(k) <= most[1])
    return float(power[np.maximum(abs(h), abs(k)) > 1].sum() / max(power.sum(), 1e-30))


def _lengths(
    basis: NDArray[np.float64], bins: int, centre: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`lengths_of` the (bins * bins,) bins of a cell from the nearest microimage centre."""
    column, row = np.meshgrid((np.arange(bins) + 0.5) / bins, (np.arange(bins) + 0.5) / bins)
    offset = np.column_stack([column.ravel(), row.ravel()]) - centre
    offset -= np.rint(offset)
    delta = (offset[:, None] - _AROUND) @ basis
    nearest = np.hypot(delta[..., 0], delta[..., 1]).argmin(1)
    return lengths_of(basis, delta[np.arange(len(delta)), nearest])


def lengths_of(
    basis: NDArray[np.float64], offset: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n,) distances [px] of places, `offset` (n, 2) [px] from the centre, to it and to the border of the cell."""
    steps = _AROUND[np.abs(_AROUND).sum(1) > 0] @ basis
    length = np.hypot(*steps.T)
    return np.hypot(*offset.T), (0.5 * length - offset @ steps.T / length).min(1)


def _explained(cell: NDArray[np.float64], lengths: tuple[NDArray[np.float64], NDArray[np.float64]]) -> float:
    """Share of the variance of a cell that a sum of a function of each length explains, 0..1."""
    values = cell.ravel() - cell.mean()
    left = values - explained_by(values, lengths)
    return 1 - float(left @ left) / max(float(values @ values), 1e-30)


def explained_by(
    values: NDArray[np.float64], lengths: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> NDArray[np.float64]:
    """The sum of a function of each length (n,) that is next to `values` (n,), or to each column of (n, m)."""
    design = np.hstack([_hats(length) for length in lengths])
    fitted: NDArray[np.float64] = design @ np.linalg.lstsq(design, values, rcond=None)[0]
    return fitted


def _hats(length: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, _LENGTHS) piecewise linear functions of a length."""
    place = (length - length.min()) / max(float(np.ptp(length)), 1e-12) * (_LENGTHS - 1)
    return np.clip(1 - np.abs(place[:, None] - np.arange(_LENGTHS)), 0, None)
