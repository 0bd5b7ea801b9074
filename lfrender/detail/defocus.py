"""Measure the defocus of the microlenses on the flat that is to be drawn.

A microlens blurs over a disc of diameter `A |s / D - f|`: `A` is its aperture and `f` the `s / D` at which it is in
focus (docs/geometry.md). Both are found by comparing cross spectra of neighbouring microimages, by type and range of
depth, with those of scenes of all scales (power laws) that are soft themselves, blurred by disc and pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, LensBlur

from .compression import Look, find_blocks
from .settings import COMPRESSION, DEFOCUS, SPECTRA, DefocusSettings
from .spectra import PairSpectrum, analysis, pair_spectra
from .transfer import disc_transfer

__all__ = ["Defocus", "measure_defocus"]

# s / D at which discs are tabulated, and diameters [px] of the discs that are tried.
_RATIOS = np.linspace(-0.8, 0.8, 33)
_DISCS = np.linspace(0, 9, 91)
_SOFT = (0.0, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.3, 1.6, 2.2, 3.0)


@dataclass(frozen=True)
class Defocus:
    """The defocus of the microlenses on a flat.

    Parameters
    ----------
    blur : LensBlur
        Aperture and focus of the microlenses, with their errors.
    discs : tuple of tuples of floats [px]
        By type, for `s / D` from -0.8 to 0.8: diameter that the disc exceeds more likely than not.
    noise : float [white]
        Standard deviation of the noise of a pixel's mean over the channels in the light of white; its variance is in
        proportion to light.
    """

    blur: LensBlur
    discs: tuple[tuple[float, ...], ...]
    noise: float

    def diameters(self, ratio: float | NDArray[np.float64]) -> NDArray[np.float64]:
        """(types, ...) diameters [px of the flat] of the disc at `ratio = s / D`, by which a type is surely blurred.

        Where there are several types, one is near its focus at any depth: what it is blurred by is the scene's.

        Examples
        --------
        >>> blur = LensBlur(10.0, 1.0, [0.0], [0.1], [-0.3], [[3.0]], [[0.2]])
        >>> Defocus(blur, (tuple(10 * abs(r) for r in np.linspace(-0.8, 0.8, 33)),), 0.01).diameters(-0.3).round(3)
        array([3.])
        """
        discs = np.array([np.interp(ratio, _RATIOS, one) for one in self.discs])
        own = discs.min(0) if len(discs) > 1 else 0.0
        return np.asarray(np.sqrt(discs**2 - own**2))


def measure_defocus(
    look: Look,
    calibration: Calibration,
    patch_size: NDArray[np.float32],
    settings: DefocusSettings = DEFOCUS,
) -> Defocus | None:
    """The defocus of the microlenses, by type; where `calibration.lens_blur` tells it, that is taken.

    Parameters
    ----------
    look : function
        Gives the part `left, top, right, bottom` of the flat.
    calibration : Calibration
    patch_size : (n,) float32 [px]
        Of all lenses, NaN where unresolved.

    Returns
    -------
    Defocus or None
        None if there are too few neighbours with a depth.
    """
    sizes = patch_size[np.abs(np.nan_to_num(patch_size)) > 1]
    if not len(sizes):
        return None
    types, pitch = calibration.lens_types, calibration.lattice.pitch
    grid = _tried(settings)[0]
    cost = np.zeros((1 if types is None else types.count, *grid.shape))
    shared = _add_priors(cost, calibration, grid, settings)
    ratios = np.quantile(sizes / pitch, settings.kept_depths)
    if np.ptp(ratios) < settings.one_depth:
        ratios = ratios[[len(ratios) // 2]]
    known = calibration.lens_blur
    if known is not None and len(known.focus) == len(cost):
        _add_known(cost, known, pitch, grid)
        if (np.abs(ratios[:, None] - known.ratios).min(1) < settings.same_depth).all():
            few = replace(SPECTRA, depth_ranges=1, pairs=settings.noise_pairs)
            noise = min((one.noise for one in pair_spectra(look, calibration, patch_size, settings=few)), default=0.0)
            return _summarise(cost, shared, grid, pitch, noise, known, settings)
    found = pair_spectra(look, calibration, patch_size, _blocks(look, calibration, patch_size))
    if not found:
        return None
    for one in found:
        cost[one.kind] += _misfit(one, pitch, grid, settings)
    noise = min(one.noise for one in found)
    return _summarise(cost, shared, grid, pitch, noise, ratios, settings)


def _blocks(look: Look, calibration: Calibration, patch_size: NDArray[np.float32]) -> tuple[int, int] | None:
    """Where blocks of compression begin, looked for in microimages of known depth."""
    centres = calibration.lattice.centres()[np.abs(np.nan_to_num(patch_size)) > 1]
    inside = ((centres > 8) & (centres < np.array(calibration.image_size) - 9)).all(1)
    some = centres[inside][:: max(1, int(inside.sum()) // COMPRESSION.places)]
    return find_blocks(look, some) if len(some) else None


@dataclass(frozen=True)
class _Grid:
    """The values that are tried; costs have the axes slopes, softness, apertures and foci."""

    slopes: NDArray[np.float64]
    softness: NDArray[np.float64]
    apertures: NDArray[np.float64]  # [pitch]
    foci: NDArray[np.float64]

    @classmethod
    def make(cls, settings: DefocusSettings) -> _Grid:
        wide = settings.spreads * settings.slope_spread
        return cls(
            settings.likely_slope + wide * np.linspace(-1, 1, settings.slope_steps),
            np.linspace(0, settings.softest, settings.soft_steps),
            np.geomspace(settings.smallest_aperture, settings.largest_aperture, settings.aperture_steps),
            np.linspace(-settings.farthest_focus, settings.farthest_focus, settings.focus_steps),
        )

    @property
    def shape(self) -> tuple[int, int, int, int]:
        return len(self.slopes), len(self.softness), len(self.apertures), len(self.foci)


@lru_cache(1)
def _tried(settings: DefocusSettings) -> tuple[_Grid, NDArray[np.int64], NDArray[np.float64]]:
    """The grid; for each of the tabulated `s / D`, the order of its discs by diameter, and these [pitch]."""
    grid = _Grid.make(settings)
    wide = (grid.apertures[:, None] * np.abs(_RATIOS[:, None, None] - grid.foci)).reshape(len(_RATIOS), -1)
    order = np.argsort(wide, 1)
    return grid, order, np.take_along_axis(wide, order, 1)


@lru_cache(16)
def _blurred_scenes(side: int, slopes: tuple[float, ...]) -> NDArray[np.float32]:
    """(slopes, soft, discs, rings): power that windows see of scenes of these slopes and widths, blurred by discs."""
    window, _, ring = analysis(side)
    finer, wide = 2, 4 * side
    leak = np.abs(np.fft.fft2(window, (wide, wide))) ** 2
    spread = np.fft.fft2(leak / leak.sum())
    along = np.fft.fftfreq(wide) * 2
    # A pixel and the interpolation between pixels, of both lenses.
    pixel = (np.sinc(along)[:, None] * np.sinc(along)) ** 6
    radius = np.rint(np.hypot(along[:, None], along) / 2 * wide).astype(int)
    frequency = np.arange(radius.max() + 1) / wide * 2
    rings = np.zeros((side + 1, len(frequency)))
    for k in range(side + 1):
        chosen = np.zeros_like(leak)
        chosen[::finer, ::finer] = ring == k
        reached = np.fft.ifft2(np.fft.fft2(chosen) * spread).real * pixel
        rings[k] = np.bincount(radius.ravel(), reached.ravel(), len(frequency)) / (ring == k).sum()
    scene = np.maximum(frequency, 0.35 / side) ** -np.array(slopes)[:, None]
    soft = np.exp(-((2 * np.pi * frequency * np.array(_SOFT)[:, None]) ** 2))
    blurred = soft[:, None] * disc_transfer(frequency, _DISCS[:, None]) ** 2
    seen = np.stack([blurred @ (rings * one).T for one in scene])
    return np.maximum(seen, 0).astype(np.float32)


def _misfit(one: PairSpectrum, pitch: float, grid: _Grid, settings: DefocusSettings) -> NDArray[np.float64]:
    """(slopes, softness, apertures, foci) half the squared misfit of a spectrum, with its best contrast."""
    frequency = np.arange(one.side + 1) / one.side
    rings = np.flatnonzero(
        (frequency > settings.lowest_frequency / one.side) & (frequency < settings.highest_frequency)
    )
    power, error = np.maximum(one.power[rings], 0), 2 * one.error[rings] ** 2 + 1e-14
    soft = np.abs(np.array(_SOFT) - (grid.softness * abs(one.ratio) / settings.soft_at)[:, None]).argmin(1)
    model = _blurred_scenes(one.side, tuple(grid.slopes.tolist()))[:, soft][..., rings].astype(float)
    kept = one.kept[rings]
    # What compression left is known to about the share that it took.
    unsure = settings.model_error**2 + (1 / np.maximum(kept, 0.01) - 1) ** 2
    model *= kept
    weight = 1 / (unsure * power**2 + error)
    level = (model @ (one.power[rings] * weight)) / ((model * model) @ weight)
    model *= level[..., None]
    spread = unsure * np.maximum(power, model) ** 2 + error
    each = (np.sqrt(1 + (one.power[rings] - model) ** 2 / spread) - 1).sum(-1)
    wanted = np.minimum(grid.apertures[:, None] * pitch * np.abs(one.ratio - grid.foci), _DISCS[-1])
    at = np.rint(wanted / _DISCS[1]).astype(int)
    return np.asarray(each[:, :, at])


def _add_priors(
    cost: NDArray[np.float64], calibration: Calibration, grid: _Grid, settings: DefocusSettings
) -> NDArray[np.float64]:
    """Add what is likely of the focus of each type to its cost; what is of the rest, (slopes, softness, apertures)."""
    types = calibration.lens_types
    for kind, one in enumerate(cost):
        focus, width = settings.likely_focus, settings.focus_spread
        if types is not None and types.focus is not None and np.isfinite(types.focus).all():
            focus, width = float(types.focus[kind]), settings.known_spread
        one += ((grid.foci - focus) / width) ** 2 / 2
    slopes = ((grid.slopes - settings.likely_slope) / settings.slope_spread) ** 2 / 2
    soft = grid.softness / settings.likely_softness
    wide = (np.log(grid.apertures / settings.likely_aperture) / settings.aperture_spread) ** 2 / 2
    return np.asarray(slopes[:, None, None] + soft[:, None] + wide)


def _add_known(cost: NDArray[np.float64], known: LensBlur, pitch: float, grid: _Grid) -> None:
    """Add to the cost how far discs are from those that the camera is known for."""
    for ratio, discs, errors in zip(known.ratios, known.discs.T, known.disc_errors.T, strict=True):
        wide = grid.apertures[:, None] * pitch * np.abs(ratio - grid.foci)
        for one, disc, error in zip(cost, discs, errors, strict=True):
            one += ((wide - disc) / error) ** 2 / 2


def _summarise(
    cost: NDArray[np.float64],
    shared: NDArray[np.float64],
    grid: _Grid,
    pitch: float,
    noise: float,
    kept: LensBlur | NDArray[np.float64],
    settings: DefocusSettings,
) -> Defocus:
    """The blur and the lower quantile of its discs, of the probability that costs tell.

    `noise` is a variance; `kept` is the blur, or the `s / D` at which its discs are told.
    """
    each = np.exp(cost.min((1, 2, 3, 4), keepdims=True) - cost)
    any_focus = each.sum(-1)
    common = np.exp(shared.min() - shared) * any_focus.prod(0)
    common /= common.sum()
    # (types, apertures, foci): of a type, whatever the others are.
    chance = np.einsum("sua,tsuaf->taf", common, each / np.maximum(any_focus, 1e-300)[..., None])

    def disc(ratio: float) -> NDArray[np.float64]:
        return np.asarray(grid.apertures[:, None] * pitch * np.abs(ratio - grid.foci))

    def spread(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        mean = (chance * values).sum((1, 2))
        return mean, np.sqrt((chance * (values - mean[:, None, None]) ** 2).sum((1, 2)))

    if not isinstance(kept, LensBlur):
        aperture, aperture_error = spread(np.broadcast_to(grid.apertures[:, None] * pitch, chance.shape[1:]))
        told = [spread(disc(ratio)) for ratio in kept]
        means, errors = (np.stack([one[n] for one in told], 1) for n in (0, 1))
        # Discs of one flat err together: each counts as a part of one measurement.
        errors = np.maximum(errors, settings.least_error) * np.sqrt(len(kept))
        focus = spread(np.broadcast_to(grid.foci, chance.shape[1:]))
        kept = LensBlur(float(aperture[0]), float(aperture_error[0]), *focus, kept, means, errors)
    _, order, wide = _tried(settings)
    reached = np.cumsum(chance.reshape(len(cost), -1)[:, order], 2)
    last = np.minimum((reached < settings.lower).sum(2), order.shape[1] - 1)
    discs = pitch * wide[np.arange(len(order)), last]
    table = tuple(tuple(float(d) for d in one) for one in discs)
    return Defocus(kept, table, float(np.sqrt(noise)))
