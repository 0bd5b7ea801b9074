"""Periodic textures: found by autocorrelation of the scene, since every shift by a period matches as well.

Some of these shifts may lie beyond those that the search tries, so that no secondary peak shows there. So a part of the
scene is drawn from its lenses and correlated with itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST
from lfcal.runtime.kernels.jit import njit

from ...flat.gray_flat import GrayFlat
from ...runtime.quantiles import median
from .settings import PeriodicitySettings

__all__ = ["autocorrelation", "find_periodic_texture", "is_periodic", "sees_little_of_scene"]

_DEFAULT = PeriodicitySettings()


# Python's error model checks every division for zero, and signed array places are checked for being negative: both
# prevent vector loops.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _draw(image, centres, sizes, lenses, middle, own, pitch, radius, stride, zoom, light, weight):
    """Draw what `lenses` see of the scene into `light`, and its weights into `weight`, both (side, side)."""
    side = light.shape[0]
    half, one = np.float32((side - 1) / 2), np.float32(1.0)
    height, width = image.shape
    # Rows of the flat lie on rows of the drawing. Pixels go to two buffers in turn, or each would wait for the last.
    bright, count = np.empty(2 * side, np.float32), np.empty(2 * side, np.float32)
    second = np.uint64(side)
    for lens in lenses:
        cx, cy = centres[lens, 0], centres[lens, 1]
        across = np.float32(-zoom * own / sizes[lens])
        first_u = half + np.float32(zoom * (cx - middle[0]) * own / pitch)
        first_v = half + np.float32(zoom * (cy - middle[1]) * own / pitch)
        for y in range(max(0, int(np.ceil(cy - radius))), min(height, int(cy + radius) + 1), stride):
            dy = np.float32(y) - cy
            v = first_v + across * dy
            wide2 = np.float32(radius * radius) - dy * dy
            if v < 0 or v >= side - 1 or wide2 < 0:
                continue
            wide, start = np.sqrt(wide2), max(0, int(np.ceil(cx - radius)))
            left, right = max(start, int(np.ceil(cx - wide))), min(width - 1, int(np.floor(cx + wide)))
            left += -(left - start) % stride
            ends = first_u + across * (np.float32(left) - cx), first_u + across * (np.float32(right) - cx)
            low, high = max(int(min(ends[0], ends[1])), 0), min(int(max(ends[0], ends[1])) + 1, side - 1)
            for k in range(low, high + 1):
                u = np.uint64(k)
                bright[u] = bright[second + u] = count[u] = count[second + u] = np.float32(0.0)
            row, into = image[y], np.uint64(0)
            for x in range(left, right + 1, stride):
                u = first_u + across * (np.float32(x) - cx)
                if u < 0 or u >= side - 1:
                    continue
                i, value = into + np.uint64(np.int32(u)), row[np.uint64(x)]
                into = second - into
                f = u - np.float32(np.int32(u))
                bright[i] += (one - f) * value
                bright[i + np.uint64(1)] += f * value
                count[i] += one - f
                count[i + np.uint64(1)] += f
            j = int(v)
            f = v - np.float32(j)
            for k in range(low, high + 1):
                u = np.uint64(k)
                value, number = bright[u] + bright[second + u], count[u] + count[second + u]
                light[j, u] += (one - f) * value
                light[j + 1, u] += f * value
                weight[j, u] += (one - f) * number
                weight[j + 1, u] += f * number


@njit(cache=True, nogil=True, error_model="numpy", share=lambda *given: len(given[4]))
def _draw_parts(
    begin, end, image, centres, sizes, lenses, ends, middles, owns, pitch, radius, stride, zoom, lights, weights
):
    """Draw each part of the scene; its `lenses` end before its place in `ends`."""
    for part in range(begin, end):
        start = ends[part - 1] if part > 0 else 0
        _draw(
            image, centres, sizes, lenses[start : ends[part]], middles[part], owns[part], pitch, radius, stride, zoom,
            lights[part], weights[part],
        )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _overlap_sums(light, reach):
    """(3, 2 * reach + 1, 2 * reach + 1): number of places that overlap others at each lag, and the sums of `light`
    (n, n) and of its square there."""
    side = len(light)
    sums, squares = np.zeros((side + 1, side + 1)), np.zeros((side + 1, side + 1))
    for y in range(side):
        total = square = 0.0
        for x in range(side):
            total += light[y, x]
            square += light[y, x] * light[y, x]
            sums[y + 1, x + 1] = sums[y, x + 1] + total
            squares[y + 1, x + 1] = squares[y, x + 1] + square
    out = np.empty((3, 2 * reach + 1, 2 * reach + 1), np.float32)
    for v in range(2 * reach + 1):
        top, bottom = max(v - reach, 0), side + min(v - reach, 0)
        for u in range(2 * reach + 1):
            left, right = max(u - reach, 0), side + min(u - reach, 0)
            out[0, v, u] = max(bottom - top, 0) * max(right - left, 0)
            out[1, v, u] = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
            out[2, v, u] = squares[bottom, right] - squares[top, right] - squares[bottom, left] + squares[top, left]
    return out


def _fast_length(least: int) -> int:
    """The smallest length from `least` on whose prime factors are 2, 3 and 5."""
    # SciPy has this too, but takes 0.2 s to import.
    while True:
        rest = least
        for prime in (2, 3, 5):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return least
        least += 1


def _lag_sums(light: NDArray[np.float32], seen: NDArray[np.bool_], reach: int) -> NDArray[np.float32]:
    """(4, 2 * reach + 1, 2 * reach + 1): as `_overlap_sums` of what is seen, and the sums of products."""
    # Padding keeps the wrapped part of the circular correlation beyond the longest lag.
    size = _fast_length(len(light) + reach)
    lags = np.arange(-reach, reach + 1)
    if seen.all() and reach < len(light):
        power = np.abs(np.fft.rfft2(light, (size, size))) ** 2
        return np.stack([*_overlap_sums(light, reach), np.fft.irfft2(power, (size, size))[lags[:, None], lags]])
    of_light, of_seen, of_square = np.fft.rfft2(np.stack([light, seen, light * light]), (size, size))
    both = np.stack([of_seen, of_light, of_square, of_light]) * np.conj([of_seen, of_seen, of_seen, of_light])
    return np.asarray(np.fft.irfft2(both, (size, size))[:, lags[:, None], lags])


def autocorrelation(
    picture: NDArray, seen: NDArray[np.bool_], reach: int, least: float, settings: PeriodicitySettings = _DEFAULT
) -> NDArray[np.float32]:
    """(2 * reach + 1, 2 * reach + 1) correlation of a picture with itself at lags up to `reach` px, 0 in the middle.

    Only what is seen in both counts.

    Parameters
    ----------
    picture : (n, n)
    seen : (n, n) bool
    reach : int [px]
    least : float
        Lags at which fewer pixels overlap get -1, and so do those at which these are flat.
    settings : PeriodicitySettings
    """
    light = np.where(seen, picture - picture[seen].mean(), 0).astype(np.float32)
    common, here, square, like = _lag_sums(light, seen, reach)
    count = np.maximum(np.rint(common), 1)
    spread = square - here**2 / count
    # Sums over the other of both overlapping parts are those at the opposite lag.
    limit = settings.least_variance * (light**2).sum() / seen.sum() * count
    product = spread * spread[::-1, ::-1]
    known = (count >= least) & (spread > limit) & (spread > limit)[::-1, ::-1]
    covariance = like - here * here[::-1, ::-1] / count
    return np.where(known, covariance / np.sqrt(np.where(known, product, 1)), -1)


@njit(cache=True, nogil=True, error_model="numpy")
def _find_peaks(correlation, decayed, same_direction):
    """Largest correlation outside the central peak, which ends where it has `decayed`, and the largest one in another
    direction; -1 if there is none."""
    side = len(correlation)
    middle = side // 2
    same, stack = np.zeros((side, side), np.bool_), np.empty((side * side, 2), np.int64)
    waiting = 0
    if correlation[middle, middle] > decayed:
        same[middle, middle], stack[0, 0], stack[0, 1], waiting = True, middle, middle, 1
    while waiting:
        waiting -= 1
        v, u = stack[waiting]
        for y, x in ((v - 1, u), (v + 1, u), (v, u - 1), (v, u + 1)):
            if 0 <= y < side and 0 <= x < side and not same[y, x] and correlation[y, x] > decayed:
                same[y, x], stack[waiting, 0], stack[waiting, 1] = True, y, x
                waiting += 1
    first = second = np.float32(-1.0)
    best_y = best_x = 0
    for turn in range(2):
        for y in range(-middle, side - middle):
            for x in range(-middle, side - middle):
                value, away2 = correlation[middle + y, middle + x], x * x + y * y
                if same[middle + y, middle + x] or away2 > middle * middle:
                    continue
                if turn == 0 and value > first:
                    first, best_y, best_x = value, y, x
                both = np.sqrt(away2 * (best_x * best_x + best_y * best_y))
                along = abs(x * best_x + y * best_y) > same_direction * both
                if turn == 1 and not along:
                    second = max(second, value)
    return first, second


def is_periodic(
    correlation: NDArray[np.float32], seen: float, settings: PeriodicitySettings = _DEFAULT
) -> tuple[bool, bool]:
    """Whether a texture repeats along two directions, and whether it may.

    Parameters
    ----------
    correlation : (m, m)
        As `autocorrelation`.
    seen : float [microimages]
        Area of the scene.
    settings : PeriodicitySettings
    """
    first, second = _find_peaks(correlation, settings.decayed, settings.same_direction)
    certain, possible = (
        any(seen >= least and first > one and second > other for least, one, other in limits)
        for limits in (settings.certain, settings.possible)
    )
    return certain, possible


@dataclass(frozen=True)
class _Part:
    """The `lenses` (m,) that see a part of the scene, and the one in its middle."""

    lenses: NDArray[np.int64]
    middle: int


def find_periodic_texture(
    gray: GrayFlat,
    indices: NDArray[np.int64],
    sizes: NDArray,
    resolved: NDArray[np.bool_],
    settings: PeriodicitySettings = _DEFAULT,
) -> tuple[NDArray[np.bool_], bool]:
    """Lenses (n,) that see a part of the scene whose texture is periodic, and whether that of most parts may be.

    If most of the parts are periodic for certain, all resolved lenses are returned.

    Parameters
    ----------
    gray : GrayFlat
    indices : (n, 2) int
        Of the lenses on the lattice.
    sizes : (n,) [px of `gray`]
        Patch sizes; those of the resolved lenses count.
    resolved : (n,) bool
    settings : PeriodicitySettings
    """
    certain = np.zeros(len(sizes), bool)
    known = np.flatnonzero(resolved & (np.abs(sizes) > 0))
    if len(known) < settings.fewest_lenses:
        return certain, False
    x, y = gray.centres[known, 0], gray.centres[known, 1]
    reach = settings.reach * gray.pitch**2 / median(np.abs(sizes[known]))
    columns, rows = (_spread_evenly(v.min(), v.max(), reach, settings.parts) for v in (x, y))
    places = [(u, v) for v in rows for u in columns]
    verdicts: list[tuple[bool, bool]] = []
    # Opposite corners first: if neither is in doubt, most parts are not.
    for some in (places[::3], places[1:3]):
        if not some or (len(verdicts) == 2 and not np.any(verdicts)):
            break
        parts = [_part_about(gray, sizes, known, u, v, settings) for u, v in some]
        for part, verdict in zip(parts, _are_parts_periodic(gray, indices, sizes, parts, settings), strict=True):
            verdicts.append(verdict)
            certain[part.lenses] |= verdict[0]
    most = np.mean(verdicts, axis=0) > 0.5
    return certain | (resolved & most[0]), bool(most[1])


def _part_about(
    gray: GrayFlat, sizes: NDArray, known: NDArray[np.int64], u: float, v: float, settings: PeriodicitySettings
) -> _Part:
    """The part of the scene about a place [px] that the `known` lenses see."""
    x, y, own = gray.centres[known, 0], gray.centres[known, 1], sizes[known]
    middle = int(((x - np.float32(u)) ** 2 + (y - np.float32(v)) ** 2).argmin())
    extent = np.float32((settings.reach + 0.5) * gray.pitch**2 / abs(float(own[middle])))
    near = np.flatnonzero((np.abs(x - x[middle]) < extent) & (np.abs(y - y[middle]) < extent))
    factor = own[near] / own[middle]
    one_surface = (factor > 1 / settings.same_surface) & (factor < settings.same_surface)
    return _Part(known[near[one_surface]], int(known[middle]))


def sees_little_of_scene(
    centres: NDArray,
    sizes: NDArray,
    resolved: NDArray[np.bool_],
    pitch: float,
    settings: PeriodicitySettings = _DEFAULT,
) -> bool:
    """Whether all lenses together see so little more of the scene than one that it hardly shows if it repeats.

    Of lenses at `centres` (n, 2) [px] those that are `resolved` (n,) count, with their patch `sizes` (n,) [px].
    """
    if not resolved.any():
        return False
    size = float(np.median(np.abs(sizes[resolved])))
    across = [float(np.ptp(centres[resolved, k])) * size / pitch**2 + 1 for k in (0, 1)]
    return across[0] * across[1] < settings.little_area


def _spread_evenly(first: float, last: float, reach: float, most: int) -> NDArray[np.float64]:
    """Middles of parts of half side `reach` between two places [px], the outer ones as far from these."""
    count = int(np.clip((last - first) / (2 * reach), 1, most))
    return first + (np.arange(count) + 0.5) * (last - first) / count


def _thin_out(part: _Part, indices: NDArray[np.int64], spacing: float) -> NDArray[np.int64]:
    """Every so many of the lenses of a part, so that they are about `spacing` steps of the lattice apart."""
    share = max(1.0, spacing**2)
    apart = int(np.sqrt(share))
    steps = (indices[part.lenses] - indices[part.middle]) % (apart, int(share / apart))
    return part.lenses[(steps == 0).all(1)]


def _are_parts_periodic(
    gray: GrayFlat, indices: NDArray[np.int64], sizes: NDArray, parts: list[_Part], settings: PeriodicitySettings
) -> list[tuple[bool, bool]]:
    """`is_periodic` for parts of the scene."""
    pitch, middles = gray.pitch, [part.middle for part in parts]
    owns = np.asarray(sizes, np.float64)[middles]
    chosen = [_thin_out(part, indices, settings.spacing * pitch / own) for part, own in zip(parts, owns, strict=True)]
    zoom = min(1.0, settings.resolution / pitch)
    side = 2 * int(np.ceil(settings.reach * pitch * zoom)) + 1
    lights, weights = np.zeros((2, len(parts), side, side), np.float32)
    stride, radius = max(1, round(0.7 / zoom)), settings.inner * gray.radius
    _draw_parts(
        gray.image, gray.centres, np.asarray(sizes, np.float64), np.concatenate(chosen),
        np.cumsum([len(lenses) for lenses in chosen]), gray.centres[middles].astype(float), owns, pitch, radius, stride,
        zoom, lights, weights,
    )  # fmt: skip
    area, limit = np.pi * (radius * zoom) ** 2, settings.least_weight / (zoom * stride) ** 2
    reach = int(np.ceil(settings.longest_lag * pitch * zoom))
    return [
        _is_drawing_periodic(light, weight, limit, area, reach, settings)
        for light, weight in zip(lights, weights, strict=True)
    ]


def _is_drawing_periodic(
    light: NDArray[np.float32],
    weight: NDArray[np.float32],
    limit: float,
    area: float,
    reach: int,
    settings: PeriodicitySettings,
) -> tuple[bool, bool]:
    """`is_periodic` for a drawing, where weights above `limit` are seen and a microimage covers an `area` [px^2]."""
    seen = weight > limit
    if seen.sum() < max(1.0, settings.certain[-1][0] * area):
        return False, False
    least = max(settings.least_overlap * float(seen.sum()), settings.least_overlap_area * area)
    picture = light / np.where(seen, weight, 1)
    return is_periodic(autocorrelation(picture, seen, reach, least, settings), float(seen.sum()) / area, settings)
