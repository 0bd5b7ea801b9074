"""Cross spectra of pairs of microimages that show the same place: the scene's power alone, without the noise of either.

What two lenses of one type see of a place differs in noise, and in how their pixels alias; the mean product of their
spectra has neither, so that the blur is seen far below the noise, and beyond the frequencies that a pixel resolves.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lfcal import Calibration

from ..flat.gray_flat import trusted_radius, white_level
from .compression import Look, kept_power
from .settings import SPECTRA, SpectraSettings

__all__ = ["Look", "PairSpectrum", "analysis", "is_encoded", "pair_spectra"]


def is_encoded(dtype: DTypeLike, calibration: Calibration) -> bool:
    """Whether values are about the square root of light: as the camera file tells, else those of 8 bits are."""
    return np.dtype(dtype) == np.uint8 if calibration.encoded is None else calibration.encoded


class PairSpectrum(NamedTuple):
    """Mean cross spectrum of many pairs of lenses of one type and range of depth."""

    kind: int
    ratio: float  # median s / D
    side: int  # [px] of the windows; ring k holds frequencies about k / side
    power: NDArray[np.float64]  # (side + 1,) [white^2]
    error: NDArray[np.float64]  # its standard error
    kept: NDArray[np.float64]  # (side + 1,) share of the scene's power that compression left
    noise: float  # variance of a pixel's mean over the channels, for each unit of light: where the pairs differ least


class _Pairs(NamedTuple):
    first: NDArray[np.int64]
    second: NDArray[np.int64]
    kind: NDArray[np.int64]
    size: NDArray[np.float64]  # mean patch size of the two [px]


def pair_spectra(
    look: Look,
    calibration: Calibration,
    patch_size: NDArray[np.float32],
    blocks: tuple[int, int] | None = None,
    settings: SpectraSettings = SPECTRA,
) -> list[PairSpectrum]:
    """Cross spectra by type and range of depth; none where too few neighbours have a depth.

    Parameters
    ----------
    look : function
        Gives a part of the flat.
    calibration : Calibration
    patch_size : (n,) float32 [px]
        Of all lenses, NaN where unresolved.
    blocks : (int, int), optional
        Where the first block of compression begins, on flats that were compressed.
    """
    pairs = _find_pairs(calibration, patch_size, settings)
    if len(pairs.first) < settings.least_pairs:
        return []
    pitch, radius = calibration.lattice.pitch, trusted_radius(calibration)
    white = white_level(look((0, 0, 1, 1)), calibration)
    return [
        found
        for some in _groups(pairs, pitch, settings)
        for found in _spectra(look, calibration, pairs, some, radius, white, blocks, settings)
    ]


def _find_pairs(calibration: Calibration, patch_size: NDArray[np.float32], settings: SpectraSettings) -> _Pairs:
    """Neighbours of one type whose patch sizes agree."""
    lattice, types = calibration.lattice, calibration.lens_types
    ij = lattice.indices()
    kinds = np.zeros(len(ij), np.int64) if types is None else types.of(ij).astype(np.int64)
    place = ij - ij.min(0) + 2
    table = np.full(place.max(0) + 3, -1)
    table[tuple(place.T)] = np.arange(len(ij))
    span = np.arange(-2, 3)
    steps = np.stack(np.meshgrid(span, span), -1).reshape(-1, 2)
    apart = np.linalg.norm(steps @ lattice.basis, axis=1) / lattice.pitch
    limit = settings.neighbours if types is None else settings.neighbours_of_type
    forward = (steps[:, 0] > 0) | ((steps[:, 0] == 0) & (steps[:, 1] > 0))
    sizes = patch_size.astype(float)
    seen = np.abs(np.nan_to_num(sizes)) > 1
    first, second = [], []
    for step in steps[forward & (apart < limit)]:
        other = table[tuple((place + step).T)]
        alike = np.abs(sizes - sizes[other]) < settings.alike * lattice.pitch
        good = np.flatnonzero((other >= 0) & seen & seen[other] & alike & (kinds == kinds[other]))
        first.append(good)
        second.append(other[good])
    a, b = (np.concatenate(part) if part else np.empty(0, np.int64) for part in (first, second))
    return _Pairs(a, b, kinds[a], (sizes[a] + sizes[b]) / 2)


def _groups(pairs: _Pairs, pitch: float, settings: SpectraSettings) -> Iterator[NDArray[np.int64]]:
    """Some pairs of each type in ranges of depth."""
    ends = np.quantile(pairs.size, np.linspace(0, 1, settings.depth_ranges + 1))
    if ends[-1] - ends[0] < settings.one_depth * pitch:
        ends = ends[[0, -1]]
    for low, high in pairwise(ends):
        inside = (pairs.size >= low) & (pairs.size <= high)
        each = [np.flatnonzero(inside & (pairs.kind == kind)) for kind in range(pairs.kind.max() + 1)]
        yield np.concatenate([one[:: max(1, len(one) // settings.pairs)] for one in each])


def _spectra(
    look: Look,
    calibration: Calibration,
    pairs: _Pairs,
    some: NDArray[np.int64],
    radius: float,
    white: float,
    blocks: tuple[int, int] | None,
    settings: SpectraSettings,
) -> Iterator[PairSpectrum]:
    """Of some pairs, by type, in windows midway between the two microimages; none if these are too small or few."""
    if not len(some):
        return
    lattice = calibration.lattice
    centres, sizes = lattice.centres(), pairs.size[some]
    shift = (centres[pairs.second[some]] - centres[pairs.first[some]]) * (sizes / lattice.pitch)[:, None]
    room = 2 * (radius - float(np.median(np.linalg.norm(shift, axis=1))) / 2) / settings.corner
    side = int(min(room, settings.largest_window)) // 2 * 2
    if side < settings.least_window:
        return
    places = centres[pairs.first[some]] - shift / 2, centres[pairs.second[some]] + shift / 2
    inside = np.ones(len(some), bool)
    for place in places:
        inside &= (place > side / 2 + 1).all(1) & (place < np.array(lattice.image_size) - side / 2 - 3).all(1)
    window, rings, _ = analysis(side)
    seen = _read(look, calibration, np.concatenate([place[inside] for place in places]), side) / np.float32(white)
    mean = np.tensordot(seen, window / window.sum())
    light = (mean[: len(mean) // 2] + mean[len(mean) // 2 :]) / 2
    seen -= mean[:, None, None]
    seen *= window
    spectra = np.fft.rfft2(seen).reshape(2, len(light), -1)
    product = (spectra[0] * spectra[1].conj()).real @ rings / (window**2).sum()
    # Pixels of one half of the flat's count as four here.
    difference = spectra[0] - spectra[1]
    apart = (difference * difference.conj()).real @ quiet_rings(side) / (8 * (window**2).sum())
    apart /= np.maximum(light, settings.darkest)[:, None]
    kinds, ratios = pairs.kind[some][inside], sizes[inside] / lattice.pitch
    for kind in range(kinds.max(initial=-1) + 1):
        own = kinds == kind
        if own.sum() >= settings.least_pairs:
            # Compression takes the noise from blank places, and adds some where there is detail.
            quiet = settings.quiet if blocks is None else 0.5
            power, noise = product[own], np.quantile(apart[own], quiet, axis=0).min()
            error = power.std(0) / np.sqrt(len(power))
            kept = np.ones(side + 1)
            if blocks is not None:
                both = np.concatenate([place[inside][own] for place in places])
                within = ((both > 8) & (both < np.array(lattice.image_size) - 9)).all(1)
                kept = kept_power(look, both[within], blocks, np.arange(side + 1) / side)
                # What two differ by is no longer independent, as far as both were rounded.
                differ = (np.abs(difference[own]) ** 2).mean(0) @ rings / (2 * (window**2).sum())
                error = np.hypot(error, (1 - kept) * differ)
            yield PairSpectrum(kind, float(np.median(ratios[own])), side, power.mean(0), error, kept, float(noise))


def _read(look: Look, calibration: Calibration, places: NDArray[np.float64], side: int) -> NDArray[np.float32]:
    """(m, 2 side, 2 side) light about places, interpolated at half pixels."""
    start = places - (side - 0.5) / 2
    low = np.floor(start).astype(int)
    boxes = np.stack([look((x, y, x + side + 2, y + side + 2)) for x, y in low.tolist()])
    if is_encoded(boxes.dtype, calibration):
        most = np.iinfo(boxes.dtype).max if boxes.dtype.kind in "ui" else 1
        boxes = boxes.astype(np.float32) ** 2 / np.float32(most)
    grey = boxes @ np.full(boxes.shape[3], 1 / boxes.shape[3], np.float32)
    share = (start - low).astype(np.float32)
    rows = _halve(grey, share[:, 1], side)
    return _halve(rows.swapaxes(1, 2), share[:, 0], side).swapaxes(1, 2)


def _halve(boxes: NDArray[np.float32], share: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    """Interpolate along the second axis, at steps of a half from `share` (m,) of the way from the first row."""
    out = np.empty((len(boxes), 2 * side, boxes.shape[2]), np.float32)
    for n, at in enumerate((share, share + np.float32(0.5))):
        weights = np.maximum(1 - np.abs(at - np.arange(3, dtype=np.float32)[:, None]), 0)[..., None, None]
        out[:, n::2] = weights[0] * boxes[:, :side] + weights[1] * boxes[:, 1 : side + 1]
        out[:, n::2] += weights[2] * boxes[:, 2 : side + 2]
    return out


@lru_cache(8)
def analysis(side: int) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
    """Window (2 side, 2 side), weights (pixels of a half spectrum, side + 1) of a mean over rings, and whole rings."""
    wide = 2 * side
    window = np.hanning(wide + 2)[1:-1]
    ring = np.rint(np.hypot(np.fft.fftfreq(wide)[:, None], np.fft.fftfreq(wide)) * wide).astype(int)
    half = ring[:, : side + 1]
    twice = np.full(half.shape, 2.0)
    twice[:, [0, -1]] = 1
    weights = np.zeros((half.size, side + 1))
    inside = half.ravel() <= side
    weights[np.flatnonzero(inside), half.ravel()[inside]] = twice.ravel()[inside]
    weights /= weights.sum(0)
    return (window[:, None] * window).astype(np.float32), weights.astype(np.float32), ring


@lru_cache(8)
def quiet_rings(side: int, settings: SpectraSettings = SPECTRA) -> NDArray[np.float32]:
    """(pixels of a half spectrum, n) weights of means over rings that noise is seen in, as it was in the pixels."""
    wide = 2 * side
    fy, fx = 2 * np.fft.fftfreq(wide)[:, None], 2 * np.fft.rfftfreq(wide)
    frequency = np.hypot(fy, fx)
    # What bilinear interpolation at half pixels leaves of the power of noise, in the mean over places.
    of_x, of_y = (np.sinc(f) ** 4 + np.sinc(2 - np.abs(f)) ** 4 for f in (fx, fy))
    left = of_x * of_y
    ends = np.linspace(settings.lowest_noise, settings.highest_noise, settings.noise_rings + 1)
    inside = (frequency[..., None] > ends[:-1]) & (frequency[..., None] <= ends[1:])
    weights = inside / left[..., None] / np.maximum(inside.sum((0, 1)), 1)
    return weights.reshape(-1, len(ends) - 1).astype(np.float32)
