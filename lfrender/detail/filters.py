"""Filters that undo the blur of the microlenses, by patch size and power of the detail.

A Wiener filter makes the mean square error least: `T H S / (H^2 S + A + N)`, with the transfer
function `H` of the picture, that of its pixels `T`, the power of detail `S`, what aliases `A`, and
noise `N` (N. Wiener 1949). Where the discs of the microlenses are not sure, `H` and `H^2` are the
means over the smallest possible ones and the expected ones. It is fitted as a sum of four bands,
the differences of smoothings (1, 2, 1) / 4 with growing distances, as a wavelet transform "a trous"
(M. Holschneider et al. 1989).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, LensBlur
from lfcal.runtime.light.transfer import disc_transfer

from ..flat.lens_type_weights import type_shares
from .blur import interpolation_transfer, possible_discs, squares_to_average

__all__ = ["SMOOTHING", "DetailFilters", "make_filters"]

#: Distances of the outer taps of the smoothings, one upon the other, that part a picture into bands
#: [px].
SMOOTHING = (1, 1, 2, 4)

_Table = NDArray[np.float64]
# What folds back onto a frequency: the spectrum of the scene about these multiples of the picture's
# sampling.
_FOLDS = ((0, 0), (-1, 0), (0, -1), (-1, -1))


@dataclass(frozen=True)
class DetailFilters:
    """What is added of each band, for the places of a picture."""

    # (p, n + 1, 4) by power of the detail over light, and patch size: first the negative ones from
    # zero, then the positive ones; the last restores nothing
    gains: NDArray[np.float32]
    # (2, n + 1) predicted power of the second band, and of both coarser ones together, of noise in
    # the light of white
    noise: NDArray[np.float32]
    per_power: NDArray[np.float32]  # (2, n + 1) power of detail for each unit of power of these
    per_ratio: float  # entries for each unit of `|s / D|`
    # A power has the row `bits / 2^23 * per_octave - weakest`, where its bits as float32 are read
    # as an integer.
    weakest: float
    per_octave: float

    @property
    def count(self) -> int:
        """Number of filters, without the last, which restores nothing."""
        return self.gains.shape[1] - 1


def make_filters(
    calibration: Calibration,
    blur: LensBlur | None,
    noise: float,
    scale: float,
    reach: float,
    depths: tuple[float, float],
    both_modes: bool = False,
) -> DetailFilters:
    """The filters for a blended picture of `scale` pixels per pitch.

    Patch sizes lie between `depths` [px], on one side of zero or on both. `noise` is as
    `measure_noise`; lenses farther than `reach` [pitch] are not averaged.
    """
    # Filters are computed for 14 powers of detail [white^2] and 16 |s / D| of either sign, and
    # tabulated more finely.
    powers = np.geomspace(1e-8, 0.015, 14)
    levels = np.geomspace(0.06, 0.8, 16)
    step = levels[1] / levels[0]
    per_ratio = 60.0
    per_octave = 2.0
    of_level = np.concatenate([-levels, levels])
    some = _is_near(of_level, step, np.array(depths) / calibration.lattice.pitch)
    seen = _Levels.of(of_level[some], noise, calibration, blur, scale, reach, both_modes)
    known, wanted, grain = seen.sums()
    fine = np.arange(round(levels[-1] * per_ratio) + 1) / per_ratio
    at = np.log(np.maximum(fine, levels[0]) / levels[0]) / np.log(step)
    near = np.concatenate([at, at + len(levels)])

    def spread(found: _Table) -> _Table:
        """From the levels that the picture needs to all entries, along the second axis."""
        table = np.zeros((found.shape[0], len(of_level), *found.shape[2:]))
        table[:, some] = found
        return _between(table, near, 1)

    first, last = (int(np.float32(p).view(np.int32)) / 2**23 for p in powers[[0, -1]])
    logs = np.arange(int((last - first) * per_octave) + 1) / per_octave + first
    strengths = (logs * 2**23).astype(np.int32).view(np.float32)
    rows = np.log10(np.maximum(strengths, powers[0]) / powers[0]) / np.log10(powers[1] / powers[0])
    # Nothing is restored of two lenses averaged, all of four.
    averaged = _averaged_views(np.abs(of_level[some]), calibration, reach)
    trusted = np.clip(averaged / 2 - 1, 0, 1)
    gains = _between(spread(trusted[:, None] * _fit(powers, known, wanted, grain)), rows, 0)
    # Of the second band, and of the coarser ones.
    power, noises = (
        spread(np.stack([one[:, -3], one[:, -2] + one[:, -1]])) for one in (known, grain)
    )
    per_power = np.divide(1, power, out=np.zeros_like(power), where=power > 0)
    # The last restores nothing.
    tables = [
        np.pad(one, ((0, 0), (0, 1), (0, 0))[: one.ndim]).astype(np.float32)
        for one in (gains, noises, per_power)
    ]
    return DetailFilters(tables[0], tables[1], tables[2], per_ratio, first * per_octave, per_octave)


def _averaged_views(ratio: _Table, calibration: Calibration, reach: float) -> _Table:
    """How many lenses a place is averaged over, at these `|s / D|`: at least one."""
    lattice = calibration.lattice
    limit = np.minimum(lattice.radius / ratio, reach * lattice.pitch)
    # Lenses count less toward the rim: as three quarters of all.
    return np.maximum(0.75 * np.pi * limit**2 / abs(float(np.linalg.det(lattice.basis))), 1.0)


def _is_near(ratios: _Table, step: float, depths: _Table) -> NDArray[np.bool_]:
    """Which of the `s / D` a picture with these ends of its depths needs, and the last ones."""
    size = np.abs(ratios)
    ends = np.sort((ratios * step, ratios / step), 0)
    last = (size == size.min()) | (size == size.max())
    return last | ((ends[0] <= depths[1]) & (ends[1] >= depths[0]))


@dataclass(frozen=True)
class _Levels:
    """How a picture shows a scene at several `s / D`.

    Frequencies (f,) are in cycles per pixel of the picture.
    """

    grown: _Table  # (n, 1) side of a pixel of the flat [px of the picture]
    # (2, n, types) smallest and expected diameters [px of the picture]
    discs: _Table
    shares: _Table  # (n, types) weights of the types, whose sum is 1
    # (n, 1) side of the square over which an output pixel is averaged [px of the picture]
    apart: _Table
    # (n, 1) of the noise of a picture's pixel with the light of white, were it one of the flat
    variance: _Table

    @classmethod
    def of(
        cls,
        ratios: _Table,
        noise: float,
        calibration: Calibration,
        blur: LensBlur | None,
        scale: float,
        reach: float,
        both_modes: bool,
    ) -> _Levels:
        lattice = calibration.lattice
        size = np.abs(ratios)
        grown = scale / (size * lattice.pitch)
        discs = possible_discs(blur, ratios).swapaxes(1, 2) * grown[:, None]
        shares = type_shares(calibration.lens_types, ratios, discs.shape[2]).T
        averaged = _averaged_views(size, calibration, reach)
        squares = squares_to_average(calibration, blur, ratios, scale, both_modes)
        apart = np.sqrt(squares) * grown
        even = np.maximum(averaged / (discs.shape[2] * (shares**2).sum(1)), 1.0)
        return cls(grown[:, None], discs, shares, apart[:, None], (noise**2 / even)[:, None])

    def _read(self, fx: _Table, fy: _Table) -> _Table:
        read = interpolation_transfer(fx * self.grown) * interpolation_transfer(fy * self.grown)
        return read * np.sinc(fx * self.apart) * np.sinc(fy * self.apart)

    def left(self, fx: _Table, fy: _Table) -> tuple[_Table, _Table, _Table]:
        """What is left of each frequency (n, f), its expected power (f,), and the rest of that."""
        frequency = np.hypot(fx, fy)
        disc = np.einsum(
            "nt,entf->enf",
            self.shares,
            np.interp(self.discs[..., None] * frequency, *_tabulated_disc()),
        )
        pixel = np.sinc(fx * self.grown) * np.sinc(fy * self.grown) * self._read(fx, fy)
        # Detail is expected to fall with the third power of frequency.
        scene = np.maximum(frequency, 0.01) ** -3.0
        return disc.mean(0) * pixel, scene, (disc**2).mean(0) * pixel**2 * scene

    def sums(self) -> _Table:
        """(3, n, 23) powers of detail, of the wanted detail, and of noise, weighted by `_basis`."""
        fx, fy, basis = _basis()
        parts = [self.left(fx + x, fy + y) for x, y in _FOLDS]
        left, scene, _ = parts[0]
        known = np.sum([power for *_, power in parts], 0)
        # Never blurrier than it is but by noise.
        wanted = np.maximum(np.maximum(np.sinc(fx) * np.sinc(fy), left) * left * scene, known)
        grain = self.variance * self.grown**2 * self._read(fx, fy) ** 2
        return np.stack([known, wanted, grain]) @ basis.T


@lru_cache(1)
def _tabulated_disc() -> tuple[_Table, _Table]:
    periods = np.linspace(0, 20, 2001)
    return periods, disc_transfer(periods)


def _between(table: _Table, at: _Table, axis: int) -> _Table:
    """Interpolate between the entries along an axis, at indices with fractions."""
    table = np.moveaxis(table, axis, 0)
    low = np.minimum(at.astype(int), len(table) - 2)
    share = (at - low).reshape(-1, *[1] * (table.ndim - 1))
    return np.moveaxis((1 - share) * table[low] + share * table[low + 1], 0, axis)


def _bands(fx: _Table, fy: _Table) -> _Table:
    """(bands, f): transfer functions of the differences of one smoothing and the next."""
    smooth = [np.ones_like(fx)]
    for step in SMOOTHING:
        smooth.append(smooth[-1] * np.cos(np.pi * fx * step) ** 2 * np.cos(np.pi * fy * step) ** 2)
    return -np.diff(np.stack(smooth), axis=0)


@lru_cache(1)
def _basis() -> tuple[_Table, _Table, _Table]:
    """Frequencies (f,) in a quarter of the spectrum, and the products of bands (23, f).

    The products are those of all pairs, the bands, and the powers of all bands but the first.
    """
    across = (np.arange(8) + 0.5) / 16
    fx, fy = (axis.ravel() for axis in np.meshgrid(across, across))
    bands = _bands(fx, fy)
    pairs = (bands[:, None] * bands).reshape(-1, bands.shape[1])
    return fx, fy, np.concatenate([pairs, bands, bands[1:] ** 2]) / len(fx)


def _fit(powers: _Table, known: _Table, wanted: _Table, grain: _Table) -> _Table:
    """(p, n, bands) gains of least mean square error for `wanted / (known + grain / power)`.

    They are those beyond the gain of the band itself.
    """
    weight = powers[:, None, None] * known + grain
    count = len(SMOOTHING)
    normal = weight[..., : count**2].reshape(*weight.shape[:2], count, count)
    right = (powers[:, None, None] * wanted - weight)[..., count**2 : -(count - 1)]
    size = np.trace(normal, axis1=2, axis2=3)
    # A ridge keeps the fit well-conditioned.
    normal = normal + np.eye(count) * (1.5e-3 * size)[..., None, None]
    return np.linalg.solve(normal, right[..., None])[..., 0]
