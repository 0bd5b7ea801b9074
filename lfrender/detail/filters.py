"""Filters that undo the blur of the microlenses, as a table over patch size and power of the detail.

A Wiener filter makes the mean square error least: `T H S / (H^2 S (1 + e) + N)`, with the transfer function `H` of the
picture, that of its pixels `T`, the power of detail `S` and noise `N` (N. Wiener 1949), and the power `e` by which
lenses contradict each other. It is fitted as a sum of four bands, the differences of blurs of growing width.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from .defocus import Defocus
from .settings import RESTORE, SMOOTHING, RestoreSettings
from .transfer import disc_transfer, interpolation_transfer

__all__ = ["DetailFilters", "make_filters"]


@dataclass(frozen=True)
class DetailFilters:
    """What is added of each band, for the places of a picture.

    Parameters
    ----------
    gains : (p, n, 4) float32
        By power of the detail, and patch size: first the negative ones from zero, then the positive ones.
    power, noise : (n, 3) float32 [white^2]
        Predicted power of each band but the finest: of detail of unit power, and of noise.
    per_ratio : float
        Entries for each unit of `|s / D|`.
    weakest, per_octave : float
        A power has the row `bits / 2^23 * per_octave - weakest`, where its bits as float32 are read as an integer.
    """

    gains: NDArray[np.float32]
    power: NDArray[np.float32]
    noise: NDArray[np.float32]
    per_ratio: float
    weakest: float
    per_octave: float


def make_filters(
    defocus: Defocus,
    calibration: Calibration,
    scale: float,
    reach: float,
    blur: float,
    channels: int,
    depths: tuple[float, float],
    settings: RestoreSettings = RESTORE,
) -> DetailFilters:
    """The filters for a blended picture.

    Parameters
    ----------
    defocus : Defocus
    calibration : Calibration
    scale : float
        Output pixels per pitch.
    reach : float [pitch]
        Lenses farther from a scene point are not averaged.
    blur : float
        As `measure_lens_blur`: how the picture was averaged over its pixels, where these are coarse.
    channels : int
    depths : (float, float) [px]
        Least and largest signed patch size of the picture; there are no filters for others.
    """
    across = (np.arange(settings.frequencies) + 0.5) / (2 * settings.frequencies)
    fx, fy = (axis.ravel() for axis in np.meshgrid(across, across))
    frequency = np.hypot(fx, fy)
    bands = _bands(fx, fy)
    scene = np.maximum(frequency, 0.01) ** -settings.slope
    pixel = np.sinc(fx) * np.sinc(fy)
    powers = 10 ** np.arange(*settings.powers)
    ratios = np.geomspace(settings.least_ratio, settings.largest_ratio, settings.levels)
    lattice = calibration.lattice
    cell = abs(float(np.linalg.det(lattice.basis)))
    gains, power, noise = [], [], []
    step = ratios[1] / ratios[0]
    for ratio in (*-ratios, *ratios):
        ends = sorted((ratio * step, ratio / step))
        if ends[0] > depths[1] / lattice.pitch or ends[1] < depths[0] / lattice.pitch:
            nearest = min(abs(ratio), ratios[-1]) in (ratios[0], ratios[-1])
            if not nearest:
                power.append(np.ones(len(bands) - 1))
                noise.append(np.ones(len(bands) - 1))
                gains.append(np.zeros((len(powers), len(bands))))
                continue
        grown = scale / (abs(ratio) * lattice.pitch)  # side of a pixel of the flat [px of the picture]
        apart = np.sqrt(max(1 - (blur * scale) ** 2 - grown**2, 0.0)) if grown < 0.95 else 0.0
        read = interpolation_transfer(fx * grown) * interpolation_transfer(fy * grown)
        read = read * np.sinc(fx * apart) * np.sinc(fy * apart)
        discs = disc_transfer(frequency, defocus.diameters(float(ratio))[:, None] * grown).mean(0)
        left = discs * np.sinc(fx * grown) * np.sinc(fy * grown) * read
        # Lenses count less toward the rim: as three quarters of all.
        limit = min(lattice.radius / abs(ratio), reach * lattice.pitch)
        averaged = max(0.75 * np.pi * limit**2 / cell, 1.0)
        grain = defocus.noise**2 * channels * grown**2 / averaged * read**2
        low, high = settings.few_views
        trusted = np.clip((averaged - low) / (high - low), 0, 1)
        contradiction = settings.mismatch + (2 * np.pi * frequency * settings.jitter * grown) ** 2
        seen = left * left * scene
        power.append((seen * bands[1:] ** 2).mean(1))
        noise.append((grain * bands[1:] ** 2).mean(1))
        kept = (np.sinc(fx * min(grown, 1.0)) * np.sinc(fy * min(grown, 1.0))) ** settings.kept
        # Never blurrier than it is, where a coarse picture was averaged over less than its pixels.
        wanted = powers[:, None] * (np.maximum(pixel * kept, left) * left * scene)
        weight = powers[:, None] * seen * (1 + contradiction) + grain
        if grown < settings.coarse:
            wanted = np.maximum(wanted, weight)
        gains.append(trusted * _fit(bands, wanted, weight, settings))
    fine = np.arange(round(settings.largest_ratio * settings.per_ratio) + 1) / settings.per_ratio
    at = np.log(np.maximum(fine, settings.least_ratio) / settings.least_ratio) / np.log(step)
    near = np.concatenate([at, at + settings.levels])
    first, last = (int(np.float32(p).view(np.int32)) / 2**23 for p in powers[[0, -1]])
    logs = np.arange(int((last - first) * settings.per_octave) + 1) / settings.per_octave + first
    strengths = (logs * 2**23).astype(np.int32).view(np.float32)
    rows = np.log10(np.maximum(strengths, powers[0]) / powers[0]) / settings.powers[2]
    return DetailFilters(
        _between(_between(np.stack(gains, 1), rows, 0), near, 1).astype(np.float32),
        _between(np.array(power), near, 0).astype(np.float32),
        _between(np.array(noise), near, 0).astype(np.float32),
        settings.per_ratio,
        first * settings.per_octave,
        settings.per_octave,
    )


def _between(table: NDArray[np.float64], at: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Interpolate between the entries along an axis, at indices with fractions."""
    table = np.moveaxis(table, axis, 0)
    low = np.minimum(at.astype(int), len(table) - 2)
    share = (at - low).reshape(-1, *[1] * (table.ndim - 1))
    return np.moveaxis((1 - share) * table[low] + share * table[low + 1], 0, axis)


def _bands(fx: NDArray[np.float64], fy: NDArray[np.float64]) -> NDArray[np.float64]:
    """(bands, f): transfer functions of the differences of one smoothing and the next."""
    smooth = [np.ones_like(fx)]
    for step, side in SMOOTHING:
        along = [1 - 2 * side + 2 * side * np.cos(2 * np.pi * f * step) for f in (fx, fy)]
        smooth.append(smooth[-1] * along[0] * along[1])
    return -np.diff(np.stack(smooth), axis=0)


def _fit(
    bands: NDArray[np.float64], wanted: NDArray[np.float64], weight: NDArray[np.float64], settings: RestoreSettings
) -> NDArray[np.float64]:
    """(powers, bands): gains beyond the band's own of least mean square error, of `wanted / weight` (powers, f)."""
    pairs = (bands[:, None] * bands).reshape(-1, bands.shape[1])
    normal = (weight @ pairs.T).reshape(len(weight), len(bands), len(bands))
    right = (wanted - weight) @ bands.T
    size = np.trace(normal, axis1=1, axis2=2)
    normal += np.eye(len(bands)) * (settings.ridge * size)[:, None, None]
    gains = np.linalg.solve(normal, right[..., None])[..., 0]
    largest = np.abs(gains).max(1, keepdims=True)
    return np.asarray(gains * np.minimum(1, settings.largest_gain / np.maximum(largest, 1e-9)))
