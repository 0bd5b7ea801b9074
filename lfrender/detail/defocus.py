"""Measure the defocus of the microlenses on the flat that is to be drawn.

A microlens blurs over a disc of diameter `A |s / D - f|`: `A` is its aperture and `f` the `s / D` at which it is in
focus (docs/geometry.md). Both are found by comparing the power spectra of many microimages, by type and range of depth,
with those of scenes of all scales (power laws), blurred by disc and pixel, with noise added.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from ..flat.gray_flat import trusted_radius, white_level
from .settings import DEFOCUS, DefocusSettings
from .transfer import disc_transfer

__all__ = ["Defocus", "measure_defocus"]

#: Pixels (h, w, C) of the part `left, top, right, bottom` of a flat.
Look = Callable[[tuple[int, int, int, int]], NDArray]


@dataclass(frozen=True)
class Defocus:
    """The defocus of the microlenses of a camera.

    Parameters
    ----------
    aperture : float [px]
        Diameter of a microlens, as it blurs at a distance of 1 from focus.
    focus : (types,) tuple of floats [s / D]
        Where each type is in focus.
    aperture_error, focus_error : float and (types,) tuple of floats
        Standard errors.
    noise : float [white]
        Standard deviation of the noise of a pixel's mean over the channels, as the spectra have it at their end.
    slope : float
        Of the power spectrum of the scene: 3 for edges alone.
    """

    aperture: float
    focus: tuple[float, ...]
    aperture_error: float
    focus_error: tuple[float, ...]
    noise: float
    slope: float

    def diameters(self, ratio: float) -> NDArray[np.float64]:
        """(types,) diameters [px of the flat] of the disc at `ratio = s / D`.

        Examples
        --------
        >>> Defocus(10.0, (-0.2,), 0.5, (0.05,), 0.01, 2.7).diameters(-0.5).round(3)
        array([3.])
        """
        discs = self.aperture * np.abs(ratio - np.array(self.focus))
        return np.asarray(np.sqrt(np.maximum(discs**2 - self.smoothness(discs), 0)))

    def smoothness(self, discs: NDArray[np.float64]) -> float:
        """Squared diameter [px^2] by which the scene is smooth itself: with several types, one is near its focus."""
        return float(DEFOCUS.own_share * discs.min() ** 2) if len(discs) > 1 else 0.0


class _Spectra(NamedTuple):
    """Mean power spectra of lenses of one type and range of depth."""

    kind: NDArray[np.int64]  # (m,)
    ratio: NDArray[np.float64]  # (m,) median s / D
    power: NDArray[np.float64]  # (m, rings)
    lenses: NDArray[np.int64]  # (m,)


def measure_defocus(
    look: Look,
    calibration: Calibration,
    patch_size: NDArray[np.float32],
    settings: DefocusSettings = DEFOCUS,
) -> Defocus | None:
    """The defocus of the microlenses, by type.

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
        None if there are too few lenses with a depth.
    """
    side = int(min(settings.window * trusted_radius(calibration), settings.largest_window)) // 2 * 2
    types = calibration.lens_types
    count = 1 if types is None else types.count
    if side < settings.least_window:
        return None
    found = _mean_spectra(look, calibration, patch_size, side, settings)
    if not len(found.kind):
        return None
    # What remains at the highest frequencies is noise, or less.
    floor = max(settings.noise_share * float(found.power[:, -2:].min()), 1e-12)
    apertures = np.geomspace(*settings.apertures)
    foci = np.linspace(-settings.farthest_focus, settings.farthest_focus, settings.focus_steps)
    slopes = np.linspace(*settings.slopes)
    cost = _costs(found, calibration.lattice.pitch, floor, side, count, (apertures, foci, slopes), settings)
    known = None if types is None or types.focus is None or not np.isfinite(types.focus).all() else types.focus
    for kind in range(count):
        likely, spread = (settings.likely_focus, settings.focus_spread)
        if known is not None:
            likely, spread = float(known[kind]), settings.known_spread
        cost[kind] += (((foci - likely) / spread) ** 2 / 2)[None, :, None]
    prior = (np.log(apertures / settings.likely_aperture) / settings.aperture_spread) ** 2 / 2
    shared = prior[:, None] + ((slopes - settings.likely_slope) / settings.slope_spread) ** 2 / 2
    return _most_likely(cost, shared, apertures, foci, slopes, calibration.lattice.pitch, float(np.sqrt(floor)))


def _most_likely(
    cost: NDArray[np.float64],
    shared: NDArray[np.float64],
    apertures: NDArray[np.float64],
    foci: NDArray[np.float64],
    slopes: NDArray[np.float64],
    pitch: float,
    noise: float,
) -> Defocus:
    """The most likely values, and their spread, of costs (types, apertures, foci, slopes)."""
    best = cost.min(2)
    total = best.sum(0) + shared
    at, slope = np.unravel_index(int(np.argmin(total)), total.shape)
    weight = np.exp(total.min() - total)
    weight /= weight.sum()
    logs = np.log(apertures)
    mean = float((weight.sum(1) * logs).sum())
    spread = float(np.sqrt((weight.sum(1) * (logs - mean) ** 2).sum()))
    focus, errors = [], []
    for one in cost:
        share = (np.exp(one.min() - one) * weight[:, None, :]).sum((0, 2))
        share /= share.sum()
        middle = float((share * foci).sum())
        focus.append(float(foci[int(np.argmin(one[at, :, slope]))]))
        errors.append(float(np.sqrt((share * (foci - middle) ** 2).sum())))
    aperture = float(apertures[at]) * pitch
    return Defocus(aperture, tuple(focus), aperture * spread, tuple(errors), noise, float(slopes[slope]))


def _mean_spectra(
    look: Look, calibration: Calibration, patch_size: NDArray[np.float32], side: int, settings: DefocusSettings
) -> _Spectra:
    lattice, types = calibration.lattice, calibration.lens_types
    low = np.rint(lattice.centres() - (side - 1) / 2).astype(int)
    inside = (low >= 0).all(1) & (low + side <= np.array(lattice.image_size)).all(1)
    lenses = np.flatnonzero(inside & (np.abs(np.nan_to_num(patch_size)) > 1))
    kinds = np.zeros(len(lenses), int) if types is None else types.of(lattice.indices()[lenses]).astype(int)
    sizes = patch_size[lenses].astype(float)
    rows: list[tuple[int, float, NDArray[np.float64], int]] = []
    window, ring, members, _ = _analysis(side)
    if not len(lenses):
        return _Spectra(np.empty(0, int), np.empty(0), np.empty((0, len(members))), np.empty(0, int))
    shares = np.linspace(0, 1, settings.depth_ranges + 1)
    ends = np.quantile(sizes, shares)
    if ends[-1] - ends[0] < settings.one_depth * lattice.pitch:
        ends = ends[[0, -1]]
    for kind in np.unique(kinds):
        for first, last in pairwise(ends):
            some = np.flatnonzero((kinds == kind) & (sizes >= first) & (sizes <= last))
            some = some[:: max(1, len(some) // settings.lenses)]
            if len(some) < settings.least_lenses:
                continue
            corners = low[lenses[some]].tolist()
            boxes = np.stack([look((x, y, x + side, y + side)).astype(float).mean(2) for x, y in corners])
            boxes -= (boxes * window).sum((1, 2), keepdims=True) / window.sum()
            power = (np.abs(np.fft.fft2(boxes * window)) ** 2).mean(0) / (window**2).sum()
            rings = np.bincount(ring.ravel(), power.ravel())[: len(members)] / members
            rows.append((int(kind), float(np.median(sizes[some])) / lattice.pitch, rings, len(some)))
    white = white_level(look((0, 0, 1, 1)), calibration)
    kind, ratio, power, count = zip(*rows, strict=True) if rows else ((), (), np.empty((0, len(members))), ())
    return _Spectra(np.array(kind, int), np.array(ratio), np.array(power) / white**2, np.array(count, int))


@lru_cache(8)
def _analysis(side: int) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Window, ring of each frequency, their number in each ring, and what a window takes from each fine frequency.

    The last is (rings, fine): weights of the power at `_fine(side)` in the mean power of a ring.
    """
    window = np.hanning(side + 2)[1:-1]
    window = window[:, None] * window
    frequency = np.fft.fftfreq(side)
    ring = np.rint(np.hypot(frequency[:, None], frequency) * side).astype(int)
    rings = side // 2 + 1
    members = np.bincount(ring.ravel())[:rings]
    finer = 4
    leak = np.abs(np.fft.fft2(window, (finer * side, finer * side))) ** 2
    leak /= leak.sum()
    fine = np.fft.fftfreq(finer * side)
    radius = np.rint(np.hypot(fine[:, None], fine) * finer * side).astype(int)
    weights = np.zeros((rings, len(_fine(side))))
    spread = np.fft.fft2(leak)
    for k in range(rings):
        chosen = np.zeros_like(leak)
        chosen[::finer, ::finer] = ring == k
        reached = np.fft.ifft2(np.fft.fft2(chosen) * spread).real
        weights[k] = np.bincount(radius.ravel(), reached.ravel(), weights.shape[1])[: weights.shape[1]] / members[k]
    return window, ring, members, np.maximum(weights, 0)


def _fine(side: int) -> NDArray[np.float64]:
    """Frequencies [1 / px] at which the power of scenes is computed."""
    return np.arange(int(np.ceil(0.5**0.5 * 4 * side)) + 2) / (4 * side)


@lru_cache(8)
def _blurred_scenes(side: int, slopes: tuple[float, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Diameters [px] of discs, and (slopes, diameters, rings) log of the power that windows see of scenes."""
    leak, fine = _analysis(side)[3], _fine(side)
    # A pixel, averaged over directions; aliasing adds little to it.
    turned = np.linspace(0, np.pi / 4, 8)
    pixel = np.mean([(np.sinc(fine * np.cos(t)) * np.sinc(fine * np.sin(t))) ** 2 for t in turned], 0)
    scene = np.maximum(fine, 0.35 / side) ** -np.array(slopes)[:, None] * pixel
    diameters = np.linspace(0, 9, 91)
    blurred = disc_transfer(fine, diameters[:, None]) ** 2
    # (slopes, diameters, rings), without the mean and the first ring.
    return diameters, np.log(np.einsum("sf,df,rf->sdr", scene, blurred, leak, optimize=True)[..., 2:])


def _costs(
    found: _Spectra,
    pitch: float,
    floor: float,
    side: int,
    count: int,
    grid: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    settings: DefocusSettings,
) -> NDArray[np.float64]:
    """(types, apertures, foci, slopes) half the squared misfit of the spectra, each with its best contrast."""
    apertures, foci, slopes = grid
    members = _analysis(side)[2]
    diameters, model = _blurred_scenes(side, tuple(slopes.tolist()))
    cost = np.zeros((count, len(apertures), len(foci), len(slopes)))
    for kind, ratio, power, lenses in zip(*found, strict=True):
        seen = power[2:]
        signal = np.clip(1 - floor / seen, 0.02, 1)
        error = np.sqrt(settings.model_error**2 + 2 / (lenses * members[2:]))
        weight = (signal / error) ** 2
        level = (np.log(seen * signal) - model) @ weight / weight.sum()
        misfit = np.log(seen) - np.log(np.exp(level[..., None] + model) + floor)
        # A misfit of the model is alike at neighbouring frequencies: rings are worth about four.
        squares = 2 * (np.sqrt(1 + (misfit / error) ** 2) - 1)
        each = 0.5 * squares.mean(-1) * 4
        wanted = np.minimum(apertures[:, None] * pitch * np.abs(ratio - foci), diameters[-1])
        at = np.rint(wanted / diameters[1]).astype(int)
        cost[kind] += np.moveaxis(each[:, at], 0, -1)
    return cost
