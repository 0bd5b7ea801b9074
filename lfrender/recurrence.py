"""Textures that repeat: what lenses see of the scene is seen again so near that other depths explain it as well.

At any of these depths neighbouring microimages match, those beyond reach among them, so that the shifts that can be
matched do not tell of all. The scene itself does: drawn from its lenses, a part of it is laid over itself.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import label

from .fastmath import FAST
from .radiance import GrayFlat

__all__ = ["autocorrelation", "hardly_seen", "recurring", "repeats"]

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


@njit(cache=True, nogil=True, fastmath=FAST)
def _lay_out(image, centres, sizes, lenses, middle, own, pitch, radius, stride, zoom, light, weight):
    side = light.shape[0]
    half = (side - 1) / 2
    height, width = image.shape
    for lens in lenses:
        cx, cy = centres[lens, 0], centres[lens, 1]
        ratio = own / sizes[lens]
        px, py = (cx - middle[0]) * own / pitch, (cy - middle[1]) * own / pitch
        for y in range(max(0, int(np.ceil(cy - radius))), min(height, int(cy + radius) + 1), stride):
            for x in range(max(0, int(np.ceil(cx - radius))), min(width, int(cx + radius) + 1), stride):
                dx, dy = x - cx, y - cy
                if dx * dx + dy * dy > radius * radius:
                    continue
                u, v = half + zoom * (px - dx * ratio), half + zoom * (py - dy * ratio)
                if u < 0 or v < 0 or u >= side - 1 or v >= side - 1:
                    continue
                i, j, value = int(u), int(v), image[y, x]
                fu, fv = u - i, v - j
                w01, w11 = fu * (1 - fv), fu * fv
                w00, w10 = 1 - fv - w01, fv - w11
                light[j, i] += w00 * value
                light[j, i + 1] += w01 * value
                light[j + 1, i] += w10 * value
                light[j + 1, i + 1] += w11 * value
                weight[j, i] += w00
                weight[j, i + 1] += w01
                weight[j + 1, i] += w10
                weight[j + 1, i + 1] += w11


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
    # What is carried round the border lies beyond the longest lag.
    size = fft.next_fast_len(len(picture) + reach, real=True)
    light = np.where(seen, picture - picture[seen].mean(), 0).astype(np.float32)
    of_light, of_seen, of_square = fft.rfft2(np.stack([light, seen, light * light]), (size, size))
    both = np.stack([of_seen, of_light, of_square, of_light]) * np.conj([of_seen, of_seen, of_seen, of_light])
    lags = np.arange(-reach, reach + 1)
    common, here, square, like = fft.irfft2(both, (size, size))[:, lags[:, None], lags]
    count = np.maximum(np.rint(common), 1)
    spread = square - here**2 / count
    # At the opposite lag the other of both is moved.
    limit = _CONTRAST * (light**2).sum() / seen.sum() * count
    product = spread * spread[::-1, ::-1]
    known = (count >= least) & (spread > limit) & (spread > limit)[::-1, ::-1]
    covariance = like - here * here[::-1, ::-1] / count
    return np.where(known, covariance / np.sqrt(np.where(known, product, 1)), -1)


def repeats(correlation: NDArray[np.float32], seen: float) -> tuple[bool, bool]:
    """Whether a texture comes again along two directions, and whether it may.

    Parameters
    ----------
    correlation : (m, m)
        As `autocorrelation`.
    seen : float
        So many microimages' worth of the scene.
    """
    middle = len(correlation) // 2
    parts, _ = label(correlation > _ENDED)
    x, y, away = _lags(middle)
    again = np.where((parts != parts[middle, middle]) & (away <= middle), correlation, -1)
    best = again.argmax()
    along = np.abs(x * x.flat[best] + y * y.flat[best]) > _ALONG * away * away.flat[best]
    first, second = again.flat[best], np.where(along, -1, again).max()
    certain, perhaps = (
        any(seen >= least and first > one and second > other for least, one, other in limits)
        for limits in (_AGAIN, _PERHAPS)
    )
    return certain, perhaps


@lru_cache(maxsize=8)
def _lags(reach: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Lags `x, y` up to `reach` px, and how long they are. Shared by all who ask."""
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return x, y, np.hypot(x, y)


def recurring(
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
    reach = _REACH * gray.pitch**2 / float(np.median(np.abs(own)))
    verdicts: list[tuple[bool, bool]] = []
    places = [(u, v) for v in _evenly(top, bottom, reach) for u in _evenly(left, right, reach)]
    # Opposite corners first: where neither is in doubt, most parts are not.
    for u, v in places[::3] + places[1:3]:
        if len(verdicts) == 2 and not np.any(verdicts):
            break
        middle = int(((x - np.float32(u)) ** 2 + (y - np.float32(v)) ** 2).argmin())
        extent = np.float32((_REACH + 0.5) * gray.pitch**2 / abs(float(own[middle])))
        near = np.flatnonzero((np.abs(x - x[middle]) < extent) & (np.abs(y - y[middle]) < extent))
        factor = own[near] / own[middle]
        lenses = known[near[(factor > 1 / _SURFACE) & (factor < _SURFACE)]]
        verdicts.append(_part_repeats(gray, indices, sizes, lenses, int(known[middle])))
        certain[lenses] |= verdicts[-1][0]
    most = np.mean(verdicts, axis=0) > 0.5
    return certain | (resolved & most[0]), bool(most[1])


def hardly_seen(centres: NDArray, sizes: NDArray, resolved: NDArray[np.bool_], pitch: float) -> bool:
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


def _part_repeats(
    gray: GrayFlat, indices: NDArray[np.int64], sizes: NDArray, lenses: NDArray[np.int64], middle: int
) -> tuple[bool, bool]:
    """Whether what `lenses` see of the scene about the one in the `middle` repeats, and whether it may."""
    pitch, own = gray.pitch, float(sizes[middle])
    share = max(1.0, (_APART * pitch / own) ** 2)
    apart = int(np.sqrt(share))
    chosen = lenses[((indices[lenses] - indices[middle]) % (apart, int(share / apart)) == 0).all(1)]
    zoom = min(1.0, _FINE / pitch)
    side = 2 * int(np.ceil(_REACH * pitch * zoom)) + 1
    light, weight = np.zeros((side, side)), np.zeros((side, side))
    stride, radius = max(1, int(0.7 / zoom)), _INNER * gray.radius
    place = gray.centres[middle].astype(float)
    _lay_out(
        gray.image, gray.centres, np.asarray(sizes, np.float64), chosen, place, own, pitch, radius, stride, zoom,
        light, weight,
    )  # fmt: skip
    seen = weight > _SEEN / (zoom * stride) ** 2
    area = np.pi * (radius * zoom) ** 2
    if seen.sum() < max(1.0, _AGAIN[-1][0] * area):
        return False, False
    least = max(_SHARE * float(seen.sum()), _LAID * area)
    picture = light / np.where(seen, weight, 1)
    lags = autocorrelation(picture, seen, int(np.ceil(_LONGEST * pitch * zoom)), least)
    return repeats(lags, float(seen.sum()) / area)
