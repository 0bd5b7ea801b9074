"""Periodic textures: found by autocorrelation of the scene, since every shift by a period matches
as well.

Some of these shifts may lie beyond those that the search tries, so that no secondary peak shows
there. So a part of the scene is drawn from its lenses and correlated with itself.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ...flat.gray_flat import GrayFlat

__all__ = ["autocorrelation", "find_periodic_texture", "is_periodic"]

# Half the side of a part of the scene, and the highest resolution at which it is drawn, where
# periods of a quarter of a pitch keep their shape: in pitches of a microimage and pixels per pitch.
_REACH = 2.0
_RESOLUTION = 18.0
# Correlation of what does not repeat, and below which the central peak of a texture has ended.
_DECAYED = 0.3
# Area [microimages] of which less cannot show whether it repeats.
_LEAST_AREA = 3.0


def autocorrelation(picture: NDArray, seen: NDArray[np.bool_], reach: int) -> NDArray[np.float32]:
    """(2 * reach + 1, 2 * reach + 1) correlation of a picture (n, n) with itself at lags up to
    `reach` px.

    Only what is `seen` (n, n) in both counts; -1 where that is less than a fifth.
    """
    light = np.where(seen, picture - picture[seen].mean(), 0).astype(np.float32)
    # Padding keeps the wrapped part of the circular correlation beyond the longest lag.
    size = cv2.getOptimalDFTSize(len(light) + reach)
    of_light, of_seen, of_square = np.fft.rfft2(
        np.stack([light, seen, light * light]), (size, size)
    )
    both = np.stack([of_seen, of_light, of_square, of_light]) * np.conj(
        [of_seen, of_seen, of_seen, of_light]
    )
    lags = np.arange(-reach, reach + 1)
    count, here, square, like = np.fft.irfft2(both, (size, size))[:, lags[:, None], lags]
    known = count >= 0.2 * seen.sum()
    count = np.where(known, count, 1)
    spread = np.maximum(square - here**2 / count, np.var(light[seen]) * count)
    # Sums over the other of both overlapping parts are those at the opposite lag.
    covariance = like - here * here[::-1, ::-1] / count
    return np.where(known, covariance / np.sqrt(np.maximum(spread * spread[::-1, ::-1], 1e-12)), -1)


def is_periodic(correlation: NDArray[np.float32], seen: float) -> tuple[bool, bool]:
    """Whether a texture repeats along two directions, and whether it may, by its `autocorrelation`,
    of so much that is `seen` of the scene [microimages].
    """
    middle = len(correlation) // 2
    _, parts = cv2.connectedComponents((correlation > _DECAYED).astype(np.uint8), connectivity=4)
    y, x = np.mgrid[-middle : middle + 1, -middle : middle + 1]
    away = np.hypot(x, y)
    beside = np.where((parts == parts[middle, middle]) | (away > middle), -1, correlation)
    at = np.unravel_index(beside.argmax(), beside.shape)
    along = np.abs(x * x[at] + y * y[at]) > np.abs(x * y[at] - y * x[at])
    peak = 0.5 * float(beside[at] + np.where(along, -1, beside).max())
    above = (peak - _DECAYED) * np.sqrt(seen) if seen >= _LEAST_AREA else -1.0
    # Where neighbours see a wave at wrong depths, its peaks are lower: then it may repeat.
    return above > 0.8, above > 0.4


def find_periodic_texture(
    gray: GrayFlat, indices: NDArray[np.int64], sizes: NDArray, resolved: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], bool]:
    """Lenses (n,) that see a periodic part of the scene, all if most parts are, and whether most
    may be.

    `indices` (n, 2) are those of the lenses on the lattice, `sizes` (n,) [px of `gray`] count for
    the `resolved` ones.
    """
    certain = np.zeros(len(sizes), bool)
    known = np.flatnonzero(resolved & (np.abs(sizes) > 0))
    if not len(known):
        return certain, False
    x = gray.centres[known, 0]
    y = gray.centres[known, 1]
    reach = _REACH * gray.pitch**2 / float(np.median(np.abs(sizes[known])))
    columns, rows = (_spread_evenly(v.min(), v.max(), reach) for v in (x, y))
    places = [(u, v) for v in rows for u in columns]
    verdicts: list[tuple[bool, bool]] = []
    # Opposite corners first: if neither is in doubt, most parts are not.
    for some in (places[::3], places[1:3]):
        if len(verdicts) == 2 and not np.any(verdicts):
            break
        for u, v in some:
            middle = known[((x - np.float32(u)) ** 2 + (y - np.float32(v)) ** 2).argmin()]
            lenses = _lenses_about(gray, sizes, known, middle)
            verdicts.append(_is_part_periodic(gray, indices, sizes, lenses, middle))
            certain[lenses] |= verdicts[-1][0]
    most = np.mean(verdicts, axis=0) > 0.5
    return certain | (resolved & most[0]), bool(most[1])


def _lenses_about(
    gray: GrayFlat, sizes: NDArray, known: NDArray[np.int64], middle: int
) -> NDArray[np.int64]:
    """The `known` lenses that see the part of the scene about the `middle` one, on one surface,
    maybe a slanted one.
    """
    extent = (_REACH + 0.5) * gray.pitch**2 / abs(float(sizes[middle]))
    near = known[(np.abs(gray.centres[known] - gray.centres[middle]) < np.float32(extent)).all(1)]
    factor = sizes[near] / sizes[middle]
    return near[(factor > 1 / 3) & (factor < 3)]


def _spread_evenly(first: float, last: float, reach: float) -> NDArray[np.float64]:
    """Middles of one or two parts of half side `reach` between two places [px]."""
    count = int(np.clip((last - first) / (2 * reach), 1, 2))
    return first + (np.arange(count) + 0.5) * (last - first) / count


def _is_part_periodic(
    gray: GrayFlat,
    indices: NDArray[np.int64],
    sizes: NDArray,
    lenses: NDArray[np.int64],
    middle: int,
) -> tuple[bool, bool]:
    """`is_periodic` for the part of the scene that `lenses` (m,) see about the `middle` one."""
    zoom = min(1.0, _RESOLUTION / gray.pitch)
    # About three lenses for each place are enough.
    share = max(1.0, (0.5 * gray.pitch / float(sizes[middle])) ** 2)
    apart = int(np.sqrt(share))
    steps = (indices[lenses] - indices[middle]) % (apart, int(share / apart))
    picture, seen = _draw(gray, sizes, lenses[(steps == 0).all(1)], middle, zoom)
    area = float(seen.sum() / (np.pi * (gray.radius * zoom) ** 2))
    if area < _LEAST_AREA:
        return False, False
    # Depths are a period apart, and beyond 1.2 pitches none is left.
    return is_periodic(autocorrelation(picture, seen, int(np.ceil(1.2 * gray.pitch * zoom))), area)


def _draw(
    gray: GrayFlat, sizes: NDArray, lenses: NDArray[np.int64], middle: int, zoom: float
) -> tuple[NDArray[np.floating], NDArray[np.bool_]]:
    """What `lenses` (m,) see of the scene about the `middle` one, and where they see it (n, n)."""
    stride = max(1, round(0.7 / zoom))
    own = float(sizes[middle])
    radius = int(gray.radius)
    side = 2 * int(np.ceil(_REACH * gray.pitch * zoom)) + 1
    along = np.arange(-radius, radius + 1, stride)
    disc = np.hypot(*np.meshgrid(along, along)) <= gray.radius
    centres = gray.centres[lenses].astype(np.float64)
    shape = gray.image.shape[::-1]
    at = []
    pixels = []
    valid = []
    # Rows of the flat lie on rows of the drawing.
    for k in (0, 1):
        here = np.rint(centres[:, k, None]) + along
        away = (centres[:, k] - gray.centres[middle, k])[:, None] / gray.pitch
        place = np.rint(
            zoom * own * (away - (here - centres[:, k, None]) / sizes[lenses, None])
            + (side - 1) / 2
        )
        valid.append((here >= 0) & (here < shape[k]) & (place >= 0) & (place < side))
        at.append(place.astype(np.int32))
        pixels.append(here.astype(np.int32))
    inside = valid[1][:, :, None] & valid[0][:, None] & disc
    cell = (at[1][:, :, None] * side + at[0][:, None])[inside]
    value = gray.image.ravel()[(pixels[1][:, :, None] * shape[0] + pixels[0][:, None])[inside]]
    sums = np.bincount(cell, value, side * side), np.bincount(cell, minlength=side * side)
    # Pixels are shared out among the places about them.
    light, count = (
        cv2.blur(total.reshape(side, side).astype(np.float32), (2, 2)) for total in sums
    )
    return light / np.where(count > 0, count, 1), count > 0
