"""Measure the discs of the microlenses on pairs of lenses that show the same places.

The mean product of the spectra of two lenses of one type has neither the noise of their pixels nor
what aliases in them: the power of the scene is left, times that of the pixel and of the disc.
Scenes of all scales (power laws) and of all softness (Gaussian) are tried; a disc is told from
softness by how fast power vanishes towards the zero of its transfer function. Discs are the mean
over all apertures and foci, where sharp scenes and usual apertures are likelier. Discs that some
scene explains nearly as well are not excluded: the error reaches to the smallest of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from ..camera.calibration import Calibration
from ..camera.lens_types import LensBlur
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import neighbour_rows
from ..runtime.light.transfer import disc_transfer

__all__ = ["measure_lens_blur"]

_Array = NDArray[np.float64]
#: Grey light (n, side, side) of windows of a flat with these corners (n, 2), with white as one.
_Light = Callable[[NDArray[np.int64], int], NDArray[Any]]

#: [px] Discs that are tried.
_DISCS = np.linspace(0, 9, 61)
#: Power falls with frequency to one of these powers.
_SLOPES = np.arange(1.6, 4.5, 0.2)
#: [px] Standard deviations of the softness of scenes.
_SOFT = np.concatenate([[0, 0.15, 0.25, 0.33], np.geomspace(0.4, 3.2, 20)])
#: Relative error of the model, of real textures beside power laws.
_MODEL_ERROR = 0.07
#: Difference of the squared misfit up to which discs are possible.
_LIMIT = 3.0
#: [px] Scenes are softer than the flat by this in the mean. The discs of 17 simulated captures have
#: an RMS error of 0.47 px; of 0.42 or 0.56 px with half or twice of it, 0.70 px with any softness.
_USUAL_SOFTNESS = 0.25
#: [pitch] Median aperture of microlenses, and the standard deviation of its logarithm; ray-traced
#: cameras have 0.14 to 0.5. With 0.3 or 0.6 instead of 0.45, the error is 0.45 or 0.49 px.
_USUAL_APERTURE = 0.2
_APERTURE_SPREAD = 0.45
#: [s / D] Microlenses are in focus so far from 0 in the mean, on the side of the scene, with this
#: standard deviation. The discs of 16 random captures have an RMS error of 0.93 px; 1.31 px with 0
#: and 0.25, where those of clutter are twice too wide.
_USUAL_FOCUS = 0.05
_FOCUS_SPREAD = 0.15
#: [px] Error of the discs of the one aperture and focus that stand for the mean of all.
_GRID_ERROR = 0.1
#: Pairs that are read at most of each type, of all ranges of depth.
_MOST_PAIRS = 1500
#: Pairs that a mean spectrum needs.
_LEAST_PAIRS = 60
#: Ranges of depth are parted at steps of this [s / D], at most so many.
_RANGE = 0.03
_MOST_RANGES = 6
#: [pitch] Difference of the patch sizes of lenses that show one surface.
_ALIKE = 0.03
#: [s / D] Error of the focus of a lens type, as its sharpness over depth tells it: the distance of
#: the depths that are compared.
_FOCUS_ERROR = 0.05
#: [px] Half sides of windows.
_NARROWEST = 4
_WIDEST = 12


class _Pairs(NamedTuple):
    """Lenses that show the same place, and where on the flat [px] each does."""

    size: _Array  # (n,) [px] patch size
    kind: NDArray[np.int64]  # (n,) lens type
    first: _Array  # (n, 2)
    second: _Array  # (n, 2)
    apart: _Array  # (n, 2) from the centre of the first lens to that of the second

    def select(self, some: NDArray[Any]) -> _Pairs:
        """Some of the pairs."""
        return _Pairs(*(values[some] for values in self))


def _find_pairs(calibration: Calibration, patch_size: _Array) -> _Pairs:
    """The nearest lenses of one type and nearly one depth."""
    lattice = calibration.lattice
    types = calibration.lens_types
    index = lattice.indices()
    centres = lattice.centres()
    kinds = np.zeros(len(index), np.int64) if types is None else types.of(index).astype(np.int64)
    # Each step once, not there and back.
    steps = np.array([step for step in product(range(-3, 4), repeat=2) if step > (0, 0)])
    if types is not None:
        cell = np.argwhere(np.ones_like(types.cell))
        own = types.of(cell)
        steps = np.array([step for step in steps if (types.of(cell + step) == own).all()])
    lengths = np.hypot(*(steps @ lattice.basis).T)
    other = neighbour_rows(index, steps[lengths < 1.05 * lengths.min()])
    near = np.abs(patch_size - patch_size[other]) < _ALIKE * lattice.pitch
    step, one = np.nonzero((other >= 0) & near)
    two = other[step, one]
    size = (patch_size[one] + patch_size[two]) / 2
    resolved = np.abs(size) > 1
    one = one[resolved]
    two = two[resolved]
    size = size[resolved]
    apart = centres[two] - centres[one]
    moved = apart * (size / lattice.pitch)[:, None] / 2
    return _Pairs(size, kinds[one], centres[one] - moved, centres[two] + moved, apart)


class _Spectrum(NamedTuple):
    ratio: float  # median s / D
    kind: int
    power: _Array  # (rings,) mean product of the spectra [white^2]
    error: _Array  # its standard error
    side: int  # [px] of the windows


def _parts_by_depth(pairs: _Pairs, pitch: float) -> Iterator[tuple[_Pairs, float]]:
    """The pairs of each type, in ranges of depth, and how many usual ranges have as many pairs."""
    for kind in np.unique(pairs.kind):
        own = np.flatnonzero(pairs.kind == kind)
        ratio = pairs.size[own] / pitch
        low, high = np.quantile(ratio, (0.05, 0.95))
        count = min(round((high - low) / _RANGE) + 1, _MOST_RANGES)
        bounds = np.quantile(ratio, np.linspace(0, 1, count + 1)[1:-1])
        # A plane is one range: bounds lie beside it.
        bounds = bounds[np.diff(bounds, prepend=low) > _RANGE / 2] - _RANGE / 3
        which = np.searchsorted(bounds, ratio)
        for k in range(len(bounds) + 1):
            part = own[which == k]
            usual = len(part) * count / len(own)
            yield (
                pairs.select(part[:: max(1, round(len(part) * (len(bounds) + 1) / _MOST_PAIRS))]),
                usual,
            )


def _measure_spectrum(
    light: _Light, lattice: Lattice, radius: float, pairs: _Pairs
) -> _Spectrum | None:
    if len(pairs.size) < _LEAST_PAIRS:
        return None
    # The square windows lie half the shift between the two lenses from their centres.
    shift = float(np.median(np.hypot(*(pairs.second - pairs.first - pairs.apart).T)))
    room = (radius - shift / 2) / np.sqrt(2)
    # The middles of the pixels in the corners of a window lie half a pixel inside.
    if room < _NARROWEST - 0.5:
        return None
    half = int(np.clip(room, _NARROWEST, _WIDEST))
    side = 2 * half
    corners = np.rint(np.stack([pairs.first, pairs.second])).astype(int) - half
    inside = np.flatnonzero(((corners >= 0) & (corners + side <= lattice.image_size)).all((0, 2)))
    if len(inside) < _LEAST_PAIRS:
        return None
    pairs = pairs.select(inside)
    corners = corners[:, inside]
    window, _, rings = _analysis(side)
    transformed = []
    for corner in corners:
        grey = light(corner, side)
        mean = grey.reshape(len(grey), -1) @ (window.ravel() / window.sum())
        transformed.append(np.fft.rfft2((grey - mean[:, None, None]) * window))
    # Windows lie on whole pixels: what is left of the shift turns the phase.
    away = (pairs.second - corners[1]) - (pairs.first - corners[0])
    turn_x = np.exp(2j * np.pi * np.fft.rfftfreq(side) * away[:, :1])
    turn_y = np.exp(2j * np.pi * np.fft.fftfreq(side) * away[:, 1:])
    crossed = transformed[1] * transformed[0].conj() * turn_x[:, None, :] * turn_y[:, :, None]
    each = crossed.real.reshape(len(inside), -1) @ rings
    ratio = float(np.median(pairs.size)) / lattice.pitch
    return _Spectrum(
        ratio, int(pairs.kind[0]), each.mean(0), each.std(0) / np.sqrt(len(inside)), side
    )


# One entry for each side of windows.
@lru_cache(_WIDEST + 1 - _NARROWEST)
def _analysis(side: int) -> tuple[_Array, _Array, _Array]:
    """Window (side, side), and weights of the means over rings of frequency.

    The first weights (pixels, rings) are for the whole spectrum, the second ones for the half that
    `rfft2` gives.
    """
    window = np.hanning(side + 2)[1:-1]
    along = np.fft.fftfreq(side)
    ring = np.rint(np.hypot(along[:, None], along) * side).astype(int)
    weights = (ring.reshape(-1, 1) == np.arange(1, side // 2 + 1)).astype(float)
    weights /= weights.sum(0)
    half = weights.reshape(side, side, -1)[:, : side // 2 + 1].copy()
    half[:, 1 : side // 2] *= 2
    return window[:, None] * window, weights, half.reshape(-1, half.shape[2])


@lru_cache(_WIDEST + 1 - _NARROWEST)
def _blurred_scenes(side: int) -> _Array:
    """(rings, slopes, soft, discs): power in windows of blurred scenes of these kinds."""
    window, weights, _ = _analysis(side)
    finer = 4
    wide = finer * side
    leak = np.abs(np.fft.fft2(window, (wide, wide))) ** 2
    spread = np.fft.fft2(leak / leak.sum())
    along = np.fft.fftfreq(wide)
    frequency = np.hypot(along[:, None], along)
    pixel = (np.sinc(along)[:, None] * np.sinc(along)) ** 2
    radius = np.rint(frequency * wide).astype(int)
    radial = np.arange(radius.max() + 1) / wide
    response = np.zeros((weights.shape[1], len(radial)))
    for k, weight in enumerate(weights.T):
        chosen = np.zeros((wide, wide))
        chosen[::finer, ::finer] = weight.reshape(side, side)
        reached = np.fft.ifft2(np.fft.fft2(chosen) * spread).real * pixel
        response[k] = np.bincount(radius.ravel(), reached.ravel(), len(radial))
    scene = np.maximum(radial, 0.35 / side) ** -_SLOPES[:, None]
    soft = np.exp(-((2 * np.pi * radial * _SOFT[:, None]) ** 2))
    disc = disc_transfer(radial * _DISCS[:, None]) ** 2
    seen = np.einsum("kf,pf,sf,df->kpsd", response, scene, soft, disc, optimize=True)
    return seen.astype(np.float32)


def _misfit(seen: _Spectrum) -> _Array:
    """(2, discs) squared misfit of the best scene for each disc.

    The first row takes all scenes as alike, the second one adds the probability of their softness.
    """
    model = _blurred_scenes(seen.side)[1:]
    # Each ring is a plane of all scenes and discs.
    planes = (-1, 1, 1, 1)
    power = np.reshape(seen.power[1:] / seen.power[1], planes).astype(np.float32)
    error = np.reshape(seen.error[1:] / seen.power[1], planes).astype(np.float32)
    weight = 1 / ((_MODEL_ERROR * power) ** 2 + error**2)
    for _ in range(2):
        weighted = weight * model
        level = (weighted * power).sum(0) / (weighted * model).sum(0)
        fitted = level * model
        weight = 1 / ((_MODEL_ERROR * np.maximum(fitted, np.abs(power))) ** 2 + error**2)
    # Outliers count less (Charbonnier).
    each = 2 * (np.sqrt(1 + (power - fitted) ** 2 * weight) - 1)
    misfit = each.sum(0).min(0).astype(np.float64)
    # Where no scene fits, misfits count less (R. T. Birge 1932).
    misfit /= max(1.0, misfit.min() / (len(seen.power) - 3))
    unlikely = 2 * _SOFT[:, None] / _USUAL_SOFTNESS
    return np.stack([misfit.min(0), (misfit + unlikely).min(0)])


# The matrices are too small for more threads to pay off: they would wait for each other.
@threadpool_limits.wrap(limits=1, user_api="blas")
def measure_lens_blur(
    light: _Light, calibration: Calibration, patch_size: NDArray[Any], radius: float
) -> LensBlur | None:
    """The discs of all lens types at the depths of a capture; None where too few lenses show the
    same place.

    Parameters
    ----------
    light : function of (corners, side)
        Gives the grey light (n, side, side) of square windows of the flat, with white as one;
        `corners` (n, 2) are their upper left pixels.
    calibration : Calibration
        Rims whose blur its `lens_blur` tells are taken into account.
    patch_size : (n,) float [px]
        Of all lenses, NaN where unresolved.
    radius : float [px]
        Up to which microimages are read.

    Returns
    -------
    LensBlur or None
        The discs expected for scenes of usual softness. Errors reach to the smallest disc that
        explains the capture nearly as well with any scene.

    Examples
    --------
    Microimages of this radius have no room for the windows that are compared.

    >>> import lfrender
    >>> from numpy.lib.stride_tricks import sliding_window_view
    >>> flat, camera, depth = lfrender.data.example()
    >>> grey = (flat.mean(2) / 255) ** 2
    >>> def light(corners, side):
    ...     x, y = corners.T
    ...     return sliding_window_view(grey, (side, side))[y, x]
    >>> measure_lens_blur(light, camera, depth.patch_size, 8.0) is None
    True
    """
    pitch = calibration.lattice.pitch
    types = calibration.lens_types
    rims = calibration.lens_blur
    pairs = _find_pairs(calibration, np.asarray(patch_size, np.float64))
    if len(pairs.size) < _LEAST_PAIRS:
        return None
    apertures = pitch * np.geomspace(0.03, 1.0, 50)[:, None]
    foci = np.linspace(-0.8, 0.8, 81)
    # Of all scenes alike, and with the probability of their softness.
    cost = np.zeros((2, 1 if types is None else types.count, len(apertures), len(foci)))
    for part, usual in _parts_by_depth(pairs, pitch):
        seen = _measure_spectrum(light, calibration.lattice, radius, part)
        if seen is not None:
            discs = apertures * np.abs(seen.ratio - foci)
            any_scene, sharp_scene = _misfit(seen)
            cost[0, seen.kind] += usual * np.interp(discs, _DISCS, any_scene)
            cost[1, seen.kind] += np.interp(discs, _DISCS, sharp_scene)
    if not cost.any():
        return None
    if rims is not None and len(rims.focus) == cost.shape[1]:
        known, errors = rims.at([0.0])
        cost += (
            (apertures * np.abs(foci) - known[..., None]) / np.maximum(errors[..., None], 0.05)
        ) ** 2
    if types is not None and types.focus is not None:
        for kind in np.flatnonzero(np.isfinite(types.focus)):
            cost[:, kind] += ((foci - types.focus[kind]) / _FOCUS_ERROR) ** 2
    # The aperture is common to all types: each adds the misfit of its best focus.
    best = cost.min(3)
    cost += (best.sum(1, keepdims=True) - best)[..., None]
    cost[1] += (np.log(apertures / pitch / _USUAL_APERTURE) / _APERTURE_SPREAD) ** 2
    side = np.sign(pairs.size).mean()
    cost[1] += ((foci - side * _USUAL_FOCUS) / _FOCUS_SPREAD) ** 2
    ratios = np.unique(np.quantile(pairs.size / pitch, np.linspace(0.02, 0.98, 9)).round(3))
    return _summarise(cost, apertures, foci, ratios)


def _summarise(cost: _Array, apertures: _Array, foci: _Array, ratios: _Array) -> LensBlur:
    """The blur from the misfit (2, types, apertures, foci).

    The second row of the misfit gives the expected discs, the first row their errors.
    """
    allowed = cost[0] <= cost[0].min((1, 2), keepdims=True) + _LIMIT
    tried = apertures[..., None] * np.abs(ratios - foci[:, None])
    share = np.exp((cost[1].min((1, 2), keepdims=True) - cost[1]) / 2)
    share /= share.sum((1, 2), keepdims=True)
    # Wider discs than those that were compared with the capture count as the widest of these.
    compared = np.minimum(tried, _DISCS[-1])
    expected = np.sqrt(np.einsum("taf,afr->tr", share, compared**2))
    # The aperture of all types, and the focus of each, that has nearly these discs.
    away = ((tried - expected[:, None, None]) ** 2).sum(-1) / _GRID_ERROR**2 + cost[1]
    common = away.min(2).sum(0).argmin()
    best = away[:, common].argmin(1)
    discs = tried[common, best]
    smallest = np.array([tried[one].min(0) for one in allowed])
    wide, focus = np.broadcast_arrays(apertures, foci)
    spread = [(np.ptp(wide[one]) / 2, np.ptp(focus[one]) / 2) for one in allowed]
    aperture_error, focus_error = np.array(spread).T
    return LensBlur(
        float(apertures[common, 0]),
        float(aperture_error.max()),
        foci[best],
        focus_error,
        ratios,
        discs,
        np.maximum(discs - smallest, 0.05),
    )
