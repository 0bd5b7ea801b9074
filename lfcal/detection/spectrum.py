"""Candidate bases of the lattice from the narrow peaks of power spectra.

Microimages repeat with one and the same period all over a flat, scene content does not: only the
lattice makes peaks that are one frequency bin wide and lie at all integer combinations of two
frequencies.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..images.preprocessing import normalise_locally
from ..lattice.lattice import reduce_basis, shorten_bases
from ..lattice.robust_fit import robust_sigma
from ..runtime.arrays import Booleans, Floats, Singles
from .features import FlatFeatures

__all__ = ["find_periods", "is_same_lattice"]

_PROMINENCE = 4.0  # [standard deviations] of the whitened log power from which on there is a peak
_CLEAR_SUPPORT = 0.3  # of a basis by the spectrum, above which longer periods are not looked for
_MIN_SUPPORT = 0.1  # below which no pattern repeats
_WIDE = 21  # [bins] side of the box whose mean is the background of peaks
_NARROW = (
    9,
    7,
)  # [bins] the same where only peaks of a bin or two, those of lattices, are to stand out
_MOST = 7  # bases of the highest support that are given


class Candidate(NamedTuple):
    """A lattice basis [px of the flat] and how well the spectrum supports it, 0..1."""

    basis: Floats
    support: float


def is_same_lattice(one: Floats, other: Floats, tolerance: float = 0.04) -> bool:
    """Whether two bases span the same points, to a share of their steps."""
    steps = one @ np.linalg.inv(other)
    whole = np.rint(steps)
    return bool(
        abs(abs(np.linalg.det(whole)) - 1) < 0.5 and np.abs(steps - whole).max() < tolerance
    )


def _log_power(pictures: Sequence[Singles]) -> Singles | None:
    """(n, n // 2 + 1) mean log power of pictures (h, w) over a few windows; row n // 2 is zero
    frequency.

    None where they are too small for four of the shortest periods.
    """
    height, width = pictures[0].shape
    size = min(1024, height, width) // 2 * 2
    if size < 16:
        return None
    taper = np.hanning(size).astype(np.float32)
    log_power = np.zeros((size, size // 2 + 1), dtype=np.float32)
    windows = {((height - size) // 2, (width - size) // 2), (0, 0), (height - size, width - size)}
    for y, x in sorted(windows):
        for picture in pictures:
            levelled = normalise_locally(
                np.ascontiguousarray(picture[y : y + size, x : x + size]), size / 10
            )
            power = np.abs(np.fft.rfft2(levelled * taper[:, None] * taper)) ** 2
            log_power += np.log(power + np.float32(1e-6))
    return np.fft.fftshift(log_power / np.float32(len(pictures) * len(windows)), axes=0)


def _whiten(log_power: Singles, side: int) -> Singles:
    """Log power less its mean in a box of `side` bins, over its spread: its prominence in standard
    deviations.
    """
    # Mirror the half plane across zero frequency before averaging: there is no edge at fx = 0.
    margin = min(side, len(log_power) // 4)
    mirrored = np.roll(log_power[::-1, margin:0:-1], 1, axis=0)
    background = cv2.blur(np.hstack([mirrored, log_power]), (margin | 1, margin | 1))[:, margin:]
    prominence = log_power - background
    # Every fourth row is enough to estimate the spread.
    few = prominence[::4]
    middle = float(np.median(few))
    spread = robust_sigma(few - middle) + 1e-6
    return np.asarray((prominence - middle) / np.float32(spread))


def _find_peaks(p: Singles) -> tuple[Floats, Floats]:
    """Strongest narrow peaks: frequencies (k, 2) [cycles per px], refined within the bin, and
    prominences (k,).
    """
    n = len(p)
    highest = cv2.dilate(p, np.ones((5, 5), np.uint8))
    y, x = np.nonzero((p >= highest) & (p > _PROMINENCE))
    fy = y - n // 2
    period = n / np.maximum(np.hypot(x, fy), 1e-9)
    keep = (period >= 2.2) & (period <= n / 4) & ((x > 0) | (fy > 0))
    keep &= (x < p.shape[1] - 1) & (y > 0) & (y < n - 1)
    y = y[keep]
    x = x[keep]
    order = np.argsort(-p[y, x], kind="stable")[:40]
    y = y[order]
    x = x[order]
    strength = p[y, x].astype(np.float64)

    def vertex(below: NDArray, above: NDArray) -> NDArray:
        bend = below - 2 * strength + above
        return np.where(
            bend < 0, np.clip(0.5 * (below - above) / np.minimum(bend, -1e-9), -0.5, 0.5), 0.0
        )

    left = np.where(x > 0, p[y, np.abs(x - 1)], strength)
    dx = vertex(left, p[y, x + 1]) * (x > 0)
    dy = vertex(p[y - 1, x], p[y + 1, x])
    return np.column_stack([x + dx, y - n // 2 + dy]) / n, strength


def _fit_to_peaks(
    reciprocal: Floats, peaks: Floats, strength: Floats, size: int
) -> tuple[Floats, Booleans]:
    """Least-squares reciprocal bases (m, 2, 2) through all peaks near their nodes, and a mask (m,
    k) of those.

    Without those whose peaks all lie on one line.
    """
    on = np.zeros((len(reciprocal), len(peaks)), dtype=bool)
    for _ in range(4):
        node = np.rint(peaks @ np.linalg.inv(reciprocal))
        apart = peaks - node @ reciprocal
        on = (np.hypot(apart[..., 0], apart[..., 1]) * size < 1) & (np.abs(node).sum(-1) > 0)
        chosen = node * on[..., None]
        gram = chosen.transpose(0, 2, 1) @ chosen
        # Whole numbers: nodes on one line give exactly 0.
        crossed = gram[:, 0, 0] * gram[:, 1, 1] != gram[:, 0, 1] ** 2
        chosen = chosen[crossed]
        on = on[crossed]
        weighted = chosen.transpose(0, 2, 1) * strength
        reciprocal = np.linalg.solve(weighted @ chosen, weighted @ peaks)
    return reciprocal, on


def _lowest_nodes(reciprocal: Floats, count: int = 12) -> Floats:
    """(m, count, 2) nodes nearest to zero frequency, one of each opposite pair, of reciprocal bases
    (m, 2, 2).
    """
    span = np.arange(-5, 6)
    h, k = (v.ravel() for v in np.meshgrid(span, span))
    half = (h > 0) | ((h == 0) & (k > 0))
    nodes = np.column_stack([h[half], k[half]]) @ reciprocal
    order = np.argsort(np.hypot(nodes[..., 0], nodes[..., 1]), axis=1, kind="stable")[:, :count]
    return np.take_along_axis(nodes, order[..., None], axis=1)


def _find_candidates(prominence: Singles, reduction: int) -> list[Candidate]:
    """Lattices whose harmonics explain the peaks, six at most, best supported first.

    Support is the share of peaks on the nodes of the candidate (a fraction of the true period
    misses most) times the share of its lowest nodes that have a peak (a multiple of the true period
    leaves most without).
    """
    peaks, strength = _find_peaks(prominence)
    if len(peaks) < 3:
        return []
    n = len(prominence)
    # Pairs of peaks, not nearly parallel, of the strongest ones and those of the lowest
    # frequencies.
    by_period = np.argsort(np.hypot(*peaks.T), kind="stable")[:10].tolist()
    chosen = dict.fromkeys([*range(min(10, len(peaks))), *by_period])
    pairs = peaks[np.array(list(combinations(chosen, 2)))]
    lengths = np.hypot(pairs[..., 0], pairs[..., 1])
    reciprocal = shorten_bases(
        pairs[np.abs(np.linalg.det(pairs)) >= 0.2 * lengths[:, 0] * lengths[:, 1]]
    )
    lengths = np.hypot(reciprocal[..., 0], reciprocal[..., 1])
    # Periods of four pixels to a quarter of the window: shorter ones leave nothing to see in a
    # microimage.
    possible = (lengths.min(1) * n >= 4 * 0.9) & (lengths.max(1) <= 1 / (4 * np.sqrt(0.75)))
    reciprocal, on_node = _fit_to_peaks(reciprocal[possible], peaks, strength, n)
    area = np.abs(np.linalg.det(reciprocal))
    regular = (on_node.sum(1) >= 3) & (area >= 1e-9)
    reciprocal = reciprocal[regular]
    on_node = on_node[regular]
    area = area[regular]
    # Share of the peaks that are on nodes by chance.
    chance = np.minimum(0.9, np.pi / n**2 / area)
    covered = np.maximum(0.0, (on_node @ strength**2 / (strength**2).sum() - chance) / (1 - chance))
    nodes = _lowest_nodes(reciprocal)
    near = np.abs(nodes).max(2) < 0.45
    highest = cv2.dilate(prominence, np.ones((3, 3), np.uint8))
    x, y = np.moveaxis(np.rint(nodes * np.where(nodes[..., :1] < 0, -1, 1) * n).astype(int), -1, 0)
    peak = highest[(y + n // 2) % n, x.clip(0, highest.shape[1] - 1)] > _PROMINENCE
    occupied = peak & near
    support = np.where(
        near.sum(1) >= 3, covered * occupied.sum(1) / np.maximum(near.sum(1), 1), 0.0
    )
    distinct: list[Candidate] = []
    for best in np.argsort(-support, kind="stable").tolist():
        basis = reduce_basis(np.linalg.inv(reciprocal[best]).T) * reduction
        if all(
            np.abs(basis - other.basis).max() > 0.02 * np.abs(other.basis).max()
            for other in distinct
        ):
            distinct.append(Candidate(basis, float(support[best])))
        if len(distinct) == 6:
            break
    return distinct


def find_periods(features: FlatFeatures) -> Iterator[Floats]:
    """Bases (2, 2) [px] of what repeats on a flat, the best supported by its spectrum first.

    Brightness and edges show most lattices; `borders.find_line_periods` those without gaps.
    """
    given: list[Floats] = []
    for basis in _find_supported(features):
        if not any(is_same_lattice(basis, other) for other in given):
            given.append(basis)
            yield basis


def _find_supported(features: FlatFeatures) -> Iterator[Floats]:
    """Bases with the most support by brightness and edges, over short and long periods.

    Longer periods and those that stand out in few bins alone are looked for once the first has been
    refused.
    """
    smaller = features
    first: list[Candidate] = []
    spectra = []
    for reduction in (1, 2, 4):
        if reduction > 1:
            scale = 1 / reduction
            reduced: Any = cv2.resize(
                features.picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA
            )
            smaller = FlatFeatures(reduced)
        log_power = _log_power([smaller.picture, smaller.edges])
        if log_power is None:
            break
        spectra.append((log_power, reduction))
        first += _find_candidates(_whiten(log_power, _WIDE), reduction)
        if first and max(one.support for one in first) > _CLEAR_SUPPORT:
            yield max(first, key=lambda one: one.support).basis
    found = first + [
        one
        for log_power, reduction in spectra
        for side in _NARROW
        for one in _find_candidates(_whiten(log_power, side), reduction)
    ]
    found = [one for one in found if one.support >= _MIN_SUPPORT]
    for candidate in sorted(found, key=lambda one: -one.support)[:_MOST]:
        yield candidate.basis
