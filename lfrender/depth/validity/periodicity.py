"""Textures that repeat: what lenses see of the scene is seen again so near that other depths explain it as well.

At any of these depths neighbouring microimages match, those beyond reach among them, so that the shifts that can be
matched do not tell of all. The scene itself does: drawn from its lenses, a part of it is laid over itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy import fft

from lfcal.runtime.fastmath import FAST

from ...flat.gray_flat import GrayFlat
from ...runtime.quantiles import median

__all__ = ["autocorrelation", "find_periodic_texture", "is_periodic", "sees_little_of_scene"]

# Pixels of the scene over one pitch of a microimage, at most: periods of a quarter of it keep their shape.
_FINE = 18.0
# Half the side of a part of the scene, and the longest lag, in pitches of a microimage: depths are as far apart as a
# period is long, and beyond these none is left.
_REACH, _LONGEST = 2.0, 1.2
# Share of the radius within which microimages are free of rims that nobody corrects.
_INNER = 0.9
# Lenses this far apart on the scene, in pitches of a microimage, overlap some three times.
_APART = 0.5
# Patch sizes within this factor are one surface, if a slanted one.
_SURFACE = 3.0
# So much of what is seen of the scene, and of a microimage, must be laid over itself.
_SHARE, _LAID = 0.2, 0.25
# Of this share of the weight of a pixel and more, a place counts as seen.
_SEEN = 0.25
# Variance where two parts lie over each other, as a share of that of all: flat places match anything.
_CONTRAST = 0.1
# Correlation below which a texture has ended.
_ENDED = 0.3
# Correlation at which a texture comes again, in one direction and in another, where at least so many microimages'
# worth of the scene is seen: the more there is of it, the less of it repeats by chance. Where neighbours see a wave at
# depths that are not quite its own, it comes again less clearly: as from the second numbers on, it may repeat.
_AGAIN = ((20.0, 0.5, 0.45), (8.0, 0.65, 0.6), (3.0, 0.75, 0.7))
_PERHAPS = ((20.0, 0.5, 0.4), (8.0, 0.5, 0.45), (3.0, 0.6, 0.3))
# Lags with a larger cosine between them are one direction.
_ALONG = 0.87
# Lenses that see less than so many microimages' worth of it together all see nearly the same.
_ALIKE = 8.0
# Parts of the scene along each side of what the lenses cover, at most; fewer lenses tell nothing.
_PARTS, _FEWEST = 2, 8


# Python's error model checks every division, which no vector loop can. Places are unsigned: signed ones are looked at
# for being counted from the end.
@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _lay_out(image, centres, sizes, lenses, middle, own, pitch, radius, stride, zoom, light, weight):
    """Draw what `lenses` see into `light`, and how much each place counts into `weight`, both (side, side)."""
    side = light.shape[0]
    half, one = np.float32((side - 1) / 2), np.float32(1.0)
    height, width = image.shape
    # Rows of the flat lie on rows of the drawing: only along these each pixel has a place of its own. Pixels go to two
    # buffers by turns, or each would wait for the one before it.
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


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _lay_out_parts(image, centres, sizes, lenses, ends, middles, owns, pitch, radius, stride, zoom, lights, weights):
    """`_lay_out` each part of the scene into its own drawing; its `lenses` end before the place that `ends` tells."""
    for part in prange(len(ends)):
        start = ends[part - 1] if part > 0 else 0
        _lay_out(
            image, centres, sizes, lenses[start : ends[part]], middles[part], owns[part], pitch, radius, stride, zoom,
            lights[part], weights[part],
        )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _overlaps(light, reach):
    """(3, 2 * reach + 1, 2 * reach + 1): of all places that lie over others at each lag, how many they are, and the
    sums of `light` (n, n) and of its square there."""
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


def _laid_over(light: NDArray[np.float32], seen: NDArray[np.bool_], reach: int) -> NDArray[np.float32]:
    """(4, 2 * reach + 1, 2 * reach + 1): as `_overlaps` of what is seen, and the sums of products."""
    # What is carried round the border lies beyond the longest lag.
    size = fft.next_fast_len(len(light) + reach, real=True)
    lags = np.arange(-reach, reach + 1)
    if seen.all() and reach < len(light):
        power = np.abs(fft.rfft2(light, (size, size))) ** 2
        return np.stack([*_overlaps(light, reach), fft.irfft2(power, (size, size))[lags[:, None], lags]])
    of_light, of_seen, of_square = fft.rfft2(np.stack([light, seen, light * light]), (size, size))
    both = np.stack([of_seen, of_light, of_square, of_light]) * np.conj([of_seen, of_seen, of_seen, of_light])
    return np.asarray(fft.irfft2(both, (size, size))[:, lags[:, None], lags])


def autocorrelation(picture: NDArray, seen: NDArray[np.bool_], reach: int, least: float) -> NDArray[np.float32]:
    """(2 * reach + 1, 2 * reach + 1) correlation of a picture with itself at lags up to `reach` px, 0 in the middle.

    Only what is seen in both counts.

    Parameters
    ----------
    picture : (n, n)
    seen : (n, n) bool
    reach : int [px]
    least : float
        Lags at which fewer pixels lie over each other get -1, and so do those at which these are flat.
    """
    light = np.where(seen, picture - picture[seen].mean(), 0).astype(np.float32)
    common, here, square, like = _laid_over(light, seen, reach)
    count = np.maximum(np.rint(common), 1)
    spread = square - here**2 / count
    # At the opposite lag the other of both is moved.
    limit = _CONTRAST * (light**2).sum() / seen.sum() * count
    product = spread * spread[::-1, ::-1]
    known = (count >= least) & (spread > limit) & (spread > limit)[::-1, ::-1]
    covariance = like - here * here[::-1, ::-1] / count
    return np.where(known, covariance / np.sqrt(np.where(known, product, 1)), -1)


@njit(cache=True, nogil=True, error_model="numpy")
def _comes_again(correlation):
    """Largest correlation beyond that with which the texture has ended about no lag, and the largest of those in
    another direction; -1 where there is none."""
    side = len(correlation)
    middle = side // 2
    same, stack = np.zeros((side, side), np.bool_), np.empty((side * side, 2), np.int64)
    waiting = 0
    if correlation[middle, middle] > _ENDED:
        same[middle, middle], stack[0, 0], stack[0, 1], waiting = True, middle, middle, 1
    while waiting:
        waiting -= 1
        v, u = stack[waiting]
        for y, x in ((v - 1, u), (v + 1, u), (v, u - 1), (v, u + 1)):
            if 0 <= y < side and 0 <= x < side and not same[y, x] and correlation[y, x] > _ENDED:
                same[y, x], stack[waiting, 0], stack[waiting, 1] = True, y, x
                waiting += 1
    # Directions are compared by their cosine, over the lengths of both lags.
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
                along = abs(x * best_x + y * best_y) > _ALONG * np.sqrt(away2 * (best_x * best_x + best_y * best_y))
                if turn == 1 and not along:
                    second = max(second, value)
    return first, second


def is_periodic(correlation: NDArray[np.float32], seen: float) -> tuple[bool, bool]:
    """Whether a texture comes again along two directions, and whether it may.

    Parameters
    ----------
    correlation : (m, m)
        As `autocorrelation`.
    seen : float
        So many microimages' worth of the scene.
    """
    first, second = _comes_again(correlation)
    certain, perhaps = (
        any(seen >= least and first > one and second > other for least, one, other in limits)
        for limits in (_AGAIN, _PERHAPS)
    )
    return certain, perhaps


@dataclass(frozen=True)
class _Part:
    """The `lenses` (m,) that see a part of the scene, and the one in its middle."""

    lenses: NDArray[np.int64]
    middle: int


def find_periodic_texture(
    gray: GrayFlat, indices: NDArray[np.int64], sizes: NDArray, resolved: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], bool]:
    """Lenses (n,) that see a part of the scene whose texture repeats, and whether that of most parts may.

    Where most of the parts do for certain, all lenses do.

    Parameters
    ----------
    gray : GrayFlat
    indices : (n, 2) int
        Of the lenses on the lattice.
    sizes : (n,) [px of `gray`]
        Patch sizes; those of the resolved lenses count.
    resolved : (n,) bool
    """
    certain = np.zeros(len(sizes), bool)
    known = np.flatnonzero(resolved & (np.abs(sizes) > 0))
    if len(known) < _FEWEST:
        return certain, False
    x, y = gray.centres[known, 0], gray.centres[known, 1]
    own = sizes[known]
    left, top, right, bottom = x.min(), y.min(), x.max(), y.max()
    reach = _REACH * gray.pitch**2 / median(np.abs(own))
    verdicts: list[tuple[bool, bool]] = []
    places = [(u, v) for v in _evenly(top, bottom, reach) for u in _evenly(left, right, reach)]
    # Opposite corners first: where neither is in doubt, most parts are not.
    for some in (places[::3], places[1:3]):
        if not some or (len(verdicts) == 2 and not np.any(verdicts)):
            break
        parts = []
        for u, v in some:
            middle = int(((x - np.float32(u)) ** 2 + (y - np.float32(v)) ** 2).argmin())
            extent = np.float32((_REACH + 0.5) * gray.pitch**2 / abs(float(own[middle])))
            near = np.flatnonzero((np.abs(x - x[middle]) < extent) & (np.abs(y - y[middle]) < extent))
            factor = own[near] / own[middle]
            parts.append(_Part(known[near[(factor > 1 / _SURFACE) & (factor < _SURFACE)]], int(known[middle])))
        for part, verdict in zip(parts, _parts_repeat(gray, indices, sizes, parts), strict=True):
            verdicts.append(verdict)
            certain[part.lenses] |= verdict[0]
    most = np.mean(verdicts, axis=0) > 0.5
    return certain | (resolved & most[0]), bool(most[1])


def sees_little_of_scene(centres: NDArray, sizes: NDArray, resolved: NDArray[np.bool_], pitch: float) -> bool:
    """Whether all lenses together see so little more of the scene than one that it hardly shows if it repeats.

    Of lenses at `centres` (n, 2) [px] those that are `resolved` (n,) count, with their patch `sizes` (n,) [px].
    """
    if not resolved.any():
        return False
    size = float(np.median(np.abs(sizes[resolved])))
    across = [float(np.ptp(centres[resolved, k])) * size / pitch**2 + 1 for k in (0, 1)]
    return across[0] * across[1] < _ALIKE


def _evenly(first: float, last: float, reach: float) -> NDArray[np.float64]:
    """Middles of parts of this half side between two places [px], the outer ones as far from these."""
    count = int(np.clip((last - first) / (2 * reach), 1, _PARTS))
    return first + (np.arange(count) + 0.5) * (last - first) / count


def _spread_evenly(
    lenses: NDArray[np.int64], middle: int, indices: NDArray[np.int64], pitch: float, own: float
) -> NDArray[np.int64]:
    """Those of some lenses that overlap on the scene no more than they need."""
    share = max(1.0, (_APART * pitch / own) ** 2)
    apart = int(np.sqrt(share))
    return lenses[((indices[lenses] - indices[middle]) % (apart, int(share / apart)) == 0).all(1)]


def _parts_repeat(
    gray: GrayFlat, indices: NDArray[np.int64], sizes: NDArray, parts: list[_Part]
) -> list[tuple[bool, bool]]:
    """Whether parts of the scene repeat, and whether they may."""
    pitch, middles = gray.pitch, [part.middle for part in parts]
    owns = np.asarray(sizes, np.float64)[middles]
    chosen = [
        _spread_evenly(part.lenses, part.middle, indices, pitch, own) for part, own in zip(parts, owns, strict=True)
    ]
    zoom = min(1.0, _FINE / pitch)
    side = 2 * int(np.ceil(_REACH * pitch * zoom)) + 1
    lights, weights = np.zeros((2, len(parts), side, side), np.float32)
    stride, radius = max(1, round(0.7 / zoom)), _INNER * gray.radius
    _lay_out_parts(
        gray.image, gray.centres, np.asarray(sizes, np.float64), np.concatenate(chosen),
        np.cumsum([len(lenses) for lenses in chosen]), gray.centres[middles].astype(float), owns, pitch, radius, stride,
        zoom, lights, weights,
    )  # fmt: skip
    area, limit = np.pi * (radius * zoom) ** 2, _SEEN / (zoom * stride) ** 2
    reach = int(np.ceil(_LONGEST * pitch * zoom))
    return [_drawing_repeats(light, weight, limit, area, reach) for light, weight in zip(lights, weights, strict=True)]


def _drawing_repeats(
    light: NDArray[np.float32], weight: NDArray[np.float32], limit: float, area: float, reach: int
) -> tuple[bool, bool]:
    """`is_periodic` for a drawing, of which is seen what has more than this weight; a microimage is so large on it."""
    seen = weight > limit
    if seen.sum() < max(1.0, _AGAIN[-1][0] * area):
        return False, False
    least = max(_SHARE * float(seen.sum()), _LAID * area)
    picture = light / np.where(seen, weight, 1)
    return is_periodic(autocorrelation(picture, seen, reach, least), float(seen.sum()) / area)
