"""Measure a gain map: the shape microimages have in common, how it changes over the field, the light of each lens.

Every pixel of a sample of lenses is compared with the map as it is so far. What is left over is collected over the
distance to the centre (profile), over windows of the field and directions (rim), and over windows and place in the
microimage (shading); low-order polynomials of the field follow it where it is significant.

On a white image a lens has one unknown, its light. On a scene capture it shows something: a plane is fitted to its
inner part, and lenses that are no plane there count for little. Scenes say nothing about the light of lenses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from .disc_parameters import CatEye
from .fit import cell_faces, whole_lenses
from .gain_kernels import describe, light
from .gain_map import GainMap, frame, terms
from .lattice import Lattice
from .rim_cut import find_rim_cut

__all__ = ["GainFit", "fit_gain", "monomials"]

_STEP = 0.25
_ROOT_TAU = math.sqrt(2 * math.pi)
_GOLDEN = 0.6180339887498949
# The field is parted into so many windows at most, of so many lenses at least.
_WINDOWS = (8, 6)
_FEWEST = 6
_DIRECTIONS = 48
# Pixels compared in one pass: the shape has a few hundred unknowns.
_PIXELS = 6e5
# What scenes show has to average out: more are needed.
_SCENE_PIXELS = 2e6
# First passes measure the profile alone, the others also what changes over direction and field.
_PASSES = (2, 3)
# Residuals beyond so many standard deviations have no say.
_OUTLIER = 4.685
# Harmonics of the rim: lens shapes, squares and hexagons with their corners; those that change over the field.
_HARMONICS, _CHANGING = 12, 3
_RIM_DEGREE, _SHADE_DEGREE, _LEVEL_DEGREE = 2, 3, 6
# Parts of the profile of a scene nearer to 1 than so many standard errors are taken for 1.
_UNSURE = 2.0
# A part of the model stays where it is so many times its standard error and moves a rim by so many px (RMS).
_SURE, _MATTERS = 4.0, 0.02
# Inner part of a microimage, in half distances to the neighbour, on which the plane of a scene is fitted, and the
# contrast at which a lens counts half.
_CORE, _SMOOTH = 0.6, 0.06


@dataclass(frozen=True)
class GainFit:
    """A gain map without the light of single lenses, and its noise.

    Parameters
    ----------
    gain : GainMap
    spread : (k,) float64
        Standard deviation of pixels from the map at the distances of its profile, as a share of the light of a lens.
    windows : (b, a) float64
        Factor of `spread` in parts of the field, rows from the top.
    """

    gain: GainMap
    spread: NDArray[np.float64]
    windows: NDArray[np.float64]


@njit(cache=True, nogil=True)
def _solve3(m, r):
    """Plane through the core: Cramer's rule for the symmetric 3 x 3 system; the mean alone where it is singular."""
    a, b, c, d, e, f = m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]
    det = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    if abs(det) <= 1e-9 * abs(a * d * f) + 1e-300:
        return r[0] / max(a, 1e-300), 0.0, 0.0
    x = (r[0] * (d * f - e * e) - b * (r[1] * f - e * r[2]) + c * (r[1] * e - d * r[2])) / det
    y = (a * (r[1] * f - r[2] * e) - r[0] * (b * f - c * e) + c * (b * r[2] - c * r[1])) / det
    z = (a * (d * r[2] - e * r[1]) - b * (b * r[2] - c * r[1]) + r[0] * (b * e - c * d)) / det
    return x, y, z


@njit(cache=True, nogil=True, parallel=True)
def _compare(
    picture, centres, first, faces, inner, reach, core, scene, brightest, limit, field, radius, profile, step, shade,
    rim, cut, slope, ring_up, ring_down, ring_square, ring_count, normal, right, rim_up, rim_down, sector, dark,
    cut_normal, cut_right,
):  # fmt: skip
    directions = rim_up.shape[1]
    for window in prange(len(first) - 1):
        powers = np.empty(64)
        lens = np.empty(7 + rim.shape[0])
        moment, force, feature = np.empty((3, 3)), np.empty(3), np.empty(6)
        for n in range(first[window], first[window + 1]):
            cx, cy = centres[n, 0], centres[n, 1]
            describe(cx, cy, field, shade, rim, cut, powers, lens)
            moment[:], force[:] = 0.0, 0.0
            squares, count, clipped = 0.0, 0, 0
            for y in range(math.ceil(cy - core), math.floor(cy + core) + 1):
                dy = y - cy
                half = math.sqrt(max(core * core - dy * dy, 0.0))
                for x in range(math.ceil(cx - half), math.floor(cx + half) + 1):
                    dx = x - cx
                    s = light(dx, dy, lens, radius, profile, step, cut)[0]
                    if s < 0.5:
                        continue
                    v = picture[y, x] * picture[y, x]
                    clipped += v >= brightest
                    a, b = s * dx / core, s * dy / core
                    moment[0, 0] += s * s
                    moment[0, 1] += s * a
                    moment[0, 2] += s * b
                    moment[1, 1] += a * a
                    moment[1, 2] += a * b
                    moment[2, 2] += b * b
                    force[0] += s * v
                    force[1] += a * v
                    force[2] += b * v
                    squares += v * v
                    count += 1
            if count < 4 or force[0] <= 0 or clipped * 20 > count:
                continue
            gain, gx, gy, share = force[0] / moment[0, 0], 0.0, 0.0, 1.0
            if scene:
                gain, gx, gy = _solve3(moment, force)
                left = max(squares - gain * force[0] - gx * force[1] - gy * force[2], 0.0) / count
                if gain <= 0 or gx * gx + gy * gy > gain * gain:
                    continue
                # Lenses that show little beside a plane, measured by its light, say what the rim is like.
                share = _SMOOTH * _SMOOTH / (_SMOOTH * _SMOOTH + left / (gain * gain))
                gx, gy = gx / (gain * core), gy / (gain * core)
            for y in range(math.ceil(cy - reach), math.floor(cy + reach) + 1):
                dy = y - cy
                half = math.sqrt(max(reach * reach - dy * dy, 0.0))
                for x in range(math.ceil(cx - half), math.floor(cx + half) + 1):
                    dx = x - cx
                    r = math.sqrt(dx * dx + dy * dy)
                    if r > inner:
                        outside = False
                        for k in range(faces.shape[0]):
                            if dx * faces[k, 0] + dy * faces[k, 1] > 0.5:
                                outside = True
                                break
                        if outside:
                            continue
                    s, stretched, through = light(dx, dy, lens, radius, profile, step, cut)
                    plane = max(1 + gx * dx + gy * dy, 0.2)
                    e = picture[y, x] * picture[y, x] / gain - s * plane
                    if sector.shape[0] > 0:
                        # The bin of a direction is centred on it.
                        turn = math.atan2(dy, dx) / (2 * math.pi) * directions + 0.5
                        d = math.floor(turn) % directions
                        sector[window, d, 0] += share * e / plane
                        if r < inner:
                            sector[window, d, 1] += share
                    if through < 0.02:
                        dark[window, 0] += share * e
                        dark[window, 1] += share
                    place = stretched / step
                    ring = min(int(place), len(profile) - 2)
                    part = min(place - ring, 1.0)
                    if e * e > limit[window, ring]:
                        continue
                    ring_square[window, ring] += share * e * e
                    ring_count[window, ring] += share
                    if through > 0.5:
                        bright = share * through * plane
                        ring_up[window, ring] += bright * e * (1 - part)
                        ring_down[window, ring] += bright * through * plane * (1 - part)
                        ring_up[window, ring + 1] += bright * e * part
                        ring_down[window, ring + 1] += bright * through * plane * part
                    if 0.001 < through < 0.999:
                        ex, ey = dx - lens[5], dy - lens[6]
                        far = math.sqrt(ex * ex + ey * ey)
                        depth = (cut[3] - far) / cut[4]
                        push = (s - cut[5]) / through * math.exp(-0.5 * depth * depth) / (_ROOT_TAU * cut[4]) * plane
                        feature[0], feature[1] = push * ex / far, push * ey / far
                        feature[2] = (feature[0] * (cx - field[0]) + feature[1] * (cy - field[1])) / field[2]
                        feature[3], feature[4] = push, -push * depth
                        for a in range(5):
                            cut_right[window, a] += share * feature[a] * e
                            for b in range(a + 1):
                                cut_normal[window, a, b] += share * feature[a] * feature[b]
                    steep = (slope[ring] * (1 - part) + slope[ring + 1] * part) * through * plane * r / radius
                    if abs(steep) > 0.02:
                        # The bin of a direction is centred on it.
                        turn = math.atan2(dy, dx) / (2 * math.pi) * directions + 0.5
                        d = math.floor(turn) % directions
                        rim_up[window, d] -= share * steep * e
                        rim_down[window, d] += share * steep * steep
                    elif s > 0.7 and through > 0.95 and not scene:
                        u, w = dx / radius, dy / radius
                        feature[0], feature[1], feature[2] = s * u, s * w, s * u * u
                        feature[3], feature[4], feature[5] = s * u * w, s * w * w, s
                        for a in range(6):
                            right[window, a] += share * feature[a] * e
                            for b in range(a + 1):
                                normal[window, a, b] += share * feature[a] * feature[b]


@dataclass
class _Left:
    """What a pass has found: the profile as it should be, and the rest by window of the field."""

    profile: NDArray[np.float64]
    ring_square: NDArray[np.float64]
    ring_count: NDArray[np.float64]
    normal: NDArray[np.float64]
    right: NDArray[np.float64]
    rim_up: NDArray[np.float64]
    rim_down: NDArray[np.float64]
    sector: NDArray[np.float64]
    dark: float
    cut_normal: NDArray[np.float64]
    cut_right: NDArray[np.float64]
    scatter: NDArray[np.float64]


def monomials(points: NDArray[np.float64], lattice: Lattice, degree: int) -> NDArray[np.float64]:
    """(n, t) terms of a polynomial of the field at flat positions `points` (n, 2), in the order of `GainMap`."""
    middle_x, middle_y, reach = frame(lattice)
    x, y = ((points - (middle_x, middle_y)) / reach).T
    return np.column_stack([x ** (d - b) * y**b for d in range(degree + 1) for b in range(d + 1)])


def _sampled(lattice: Lattice, pixels: float) -> tuple[NDArray[np.float64], NDArray[np.int64], tuple[int, int]]:
    """Centres of whole lenses spread over the field, ordered by window; where each window begins; the grid's shape."""
    reach = cell_faces(lattice)[1]
    _, centres = whole_lenses(lattice, reach + 1)
    every = max(1.0, len(centres) * abs(float(np.linalg.det(lattice.basis))) / pixels)
    every = max(1.0, min(every, len(centres) / 200))
    centres = centres[np.arange(len(centres)) * _GOLDEN % 1 < 1 / every]
    shrink = min(1.0, math.sqrt(len(centres) / (_FEWEST * _WINDOWS[0] * _WINDOWS[1])))
    shape = max(1, int(_WINDOWS[1] * shrink)), max(1, int(_WINDOWS[0] * shrink))
    size = np.array(lattice.image_size)
    column, row = np.minimum((centres + 0.5) / size * shape[::-1], np.array(shape[::-1]) - 1).astype(int).T
    window = row * shape[1] + column
    order = np.argsort(window, kind="stable")
    first = np.searchsorted(window[order], np.arange(shape[0] * shape[1] + 1))
    return np.ascontiguousarray(centres[order]), first.astype(np.int64), shape


def fit_gain(picture: NDArray[np.float32], lattice: Lattice, scene: bool, cat_eye: CatEye | None = None) -> GainFit:
    """Shape of the microimages of a flat.

    Parameters
    ----------
    picture : (h, w) float32
        Square root of the luminance (`features.tone`).
    lattice : Lattice [px]
    scene : bool
        Whether lenses show something.
    cat_eye : CatEye or None
        The cutting disc where one is known.
    """
    reach = cell_faces(lattice)[1]
    centres, first, shape = _sampled(lattice, _SCENE_PIXELS if scene else _PIXELS)
    limit = float(np.hypot(*(lattice.steps @ lattice.basis).T).min() / 2)
    rings = int(reach / _STEP) + 3
    cut: tuple[float, ...] = ()
    if cat_eye is not None:
        cut = (*cat_eye.shift, cat_eye.growth.sum(), cat_eye.radius, cat_eye.soft)
    gain = GainMap.round(np.ones(rings), _STEP, limit, cut)
    core = (_CORE if scene else 0.5) * limit
    middle = np.array([centres[a:b].mean(0) if b > a else (0, 0) for a, b in pairwise(first)])
    spread, windows = np.full(rings, np.inf), np.ones(len(first) - 1)
    for _ in range(_PASSES[0]):
        left = _pass(picture, lattice, gain, centres, first, core, scene, spread, windows, sectors=cat_eye is None)
        gain = _scaled(gain, left)
    if cat_eye is None:
        gain = _with_cut(gain, left, middle, lattice)
    for _ in range(_PASSES[1]):
        left = _pass(picture, lattice, gain, centres, first, core, scene, spread, windows)
        gain = replace(gain, rim=_rim(left, gain, middle, lattice))
        if not scene:
            gain = replace(gain, shade=_shade(left, gain, middle, lattice))
        gain = _scaled(gain, left)
        spread, windows = _noise(left)
        if len(gain.cut):
            # Where the two rims lie upon each other, both at once would be moved twice as far as they have to.
            left = _pass(picture, lattice, gain, centres, first, core, scene, spread, windows)
            gain = replace(gain, cut=_cut(left, gain))
    if scene:
        gain = replace(gain, profile=_shown(gain.profile, left.scatter))
    return GainFit(gain, spread, windows.reshape(shape))


def _with_cut(gain: GainMap, left: _Left, middle: NDArray[np.float64], lattice: Lattice) -> GainMap:
    """The map with a cutting disc where rims are as such a disc leaves them, else as it is."""
    faces = cell_faces(lattice)[0]
    inner = float(0.5 / np.hypot(*faces.T).max())
    dark = gain.dark
    bright = np.flatnonzero(gain.profile > 0.5 * (1 + dark))
    if len(bright) == 0 or bright[-1] >= len(gain.profile) - 2:
        return gain
    edge = float(bright[-1]) * gain.step
    # Light just inside the rim, where a cut takes it away.
    height = float(np.interp(0.85 * edge, np.arange(len(gain.profile)) * gain.step, gain.profile)) - dark
    excess, area = left.sector[..., 0], left.sector[..., 1]
    square = edge**2 + excess * inner**2 / np.maximum(area * height, 1e-9)
    field = (middle - frame(lattice)[:2]) / frame(lattice)[2]
    found = find_rim_cut(np.sqrt(np.maximum(square, (0.2 * edge) ** 2)), area, field)
    if found is None:
        return gain
    rim = np.zeros((3, 3))
    rim[1, 1] = rim[2, 2] = found.own
    soft = max(0.35, 0.3 * gain.step)
    return replace(gain, rim=rim, cut=np.array([*found.shift, found.growth, found.radius, soft]))


def _pass(
    picture: NDArray[np.float32], lattice: Lattice, gain: GainMap, centres: NDArray[np.float64],
    first: NDArray[np.int64], core: float, scene: bool, spread: NDArray[np.float64], windows: NDArray[np.float64],
    sectors: bool = False,
) -> _Left:  # fmt: skip
    faces, reach = cell_faces(lattice)
    inner = float(0.5 / np.hypot(*faces.T).max())
    parts, rings = len(first) - 1, len(gain.profile)
    up, down, square, count = (np.zeros((parts, rings)) for _ in range(4))
    normal, right = np.zeros((parts, 6, 6)), np.zeros((parts, 6))
    rim_up, rim_down = np.zeros((parts, _DIRECTIONS)), np.zeros((parts, _DIRECTIONS))
    sector, dark = np.zeros((parts * sectors, _DIRECTIONS, 2)), np.zeros((parts, 2))
    cut_normal, cut_right = np.zeros((parts, 5, 5)), np.zeros((parts, 5))
    limit = (_OUTLIER * spread * windows[:, None]) ** 2
    # Light of scenes that many pixels share at the top has been clipped there; a white image may well be so even.
    brightest = 0.995 * float(picture.max()) ** 2 if scene else math.inf
    kernel: Any = _compare
    kernel(
        picture, centres, first, faces, inner, reach, core, scene, brightest, limit, *gain.shape(lattice),
        np.gradient(gain.profile, gain.step), up, down, square, count, normal, right, rim_up, rim_down, sector,
        dark, cut_normal, cut_right,
    )  # fmt: skip
    normal += np.tril(normal, -1).transpose(0, 2, 1)
    pixels = down.sum(0)
    found = np.maximum(gain.profile + up.sum(0) / np.maximum(pixels, 1e-300), 0.0)
    # Rings hardly any pixel fell into are like those beside them.
    at, filled = np.arange(rings), pixels > 1e-3 * pixels.max()
    profile = np.interp(at, at[filled], found[filled]) if filled.any() else gain.profile
    behind, pixels_behind = dark.sum(0)
    gap = gain.dark + behind / pixels_behind if pixels_behind > 0 else float(profile.min())
    return _Left(
        profile, square, count, normal, right, rim_up, rim_down, sector, max(float(gap), 0.0), cut_normal.sum(0),
        cut_right.sum(0), _scatter(up, down),
    )  # fmt: skip


def _scatter(up: NDArray[np.float64], down: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard error of the profile, from how parts of the field differ."""
    total = np.maximum(down.sum(0), 1e-12)
    miss = up - down * (up.sum(0) / total)
    parts = max(len(up), 2)
    scatter: NDArray[np.float64] = np.sqrt((miss**2).sum(0) * parts / (parts - 1)) / total
    return scatter


def _shown(profile: NDArray[np.float64], error: NDArray[np.float64]) -> NDArray[np.float64]:
    """A scene's profile, 1 wherever its scenes may have made it differ (shrinkage after James and Stein)."""
    away = profile - 1
    kept = np.maximum(1 - (_UNSURE * error / np.where(away == 0, 1e-12, away)) ** 2, 0)
    return 1 + away * kept


def _noise(left: _Left) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Standard deviation over the distance to the centre, and its factor in each window of the field."""
    smooth = np.ones(5)
    square, count = left.ring_square.sum(0), left.ring_count.sum(0)
    overall = square.sum() / max(count.sum(), 1e-12)
    few = 1e-4 * count.sum()
    near = (np.convolve(square, smooth, "same") + few * overall) / (np.convolve(count, smooth, "same") + few)
    expected = (left.ring_count * near).sum(1)
    windows = np.where(expected > 0, left.ring_square.sum(1) / np.maximum(expected, 1e-300), 1.0)
    return np.sqrt(np.maximum(near, 1e-12)), np.sqrt(np.maximum(windows, 1e-3))


def _scaled(gain: GainMap, left: _Left) -> GainMap:
    """The map with its profile corrected, brightest 1, and the light in the gaps."""
    smooth = np.convolve(np.pad(left.profile, 2, "edge"), np.ones(5) / 5, "valid")
    inner = np.arange(len(smooth)) * gain.step < gain.radius
    brightest = max(float(smooth[inner].max()), 1e-9)
    return replace(gain, profile=left.profile / brightest, dark=left.dark / brightest)


def _significant(
    blocks: list[NDArray[np.float64]], target: NDArray[np.float64], weight: NDArray[np.float64], matters: float
) -> list[NDArray[np.float64]]:
    """Least-squares factors of the columns of each block, all zero for blocks that do not matter or are not sure."""
    table = np.hstack(blocks)
    root = np.sqrt(weight)[:, None]
    usable = int((weight > 0).sum())
    if usable <= 2 * table.shape[1]:
        return [np.zeros(b.shape[1]) for b in blocks]
    ends = np.cumsum([0] + [b.shape[1] for b in blocks])
    keep = np.ones(len(blocks), dtype=bool)
    factors = np.zeros(table.shape[1])
    for _ in range(2):
        columns = np.concatenate([np.arange(ends[k], ends[k + 1]) for k in np.flatnonzero(keep)] or [np.zeros(0, int)])
        factors[:] = 0
        if len(columns) == 0:
            break
        weighted = root * table[:, columns]
        covariance = np.linalg.pinv(weighted.T @ weighted, rcond=1e-10)
        factors[columns] = covariance @ (weighted.T @ (root[:, 0] * target))
        miss = root[:, 0] * (target - table @ factors)
        covariance *= float(miss @ miss) / (usable - len(columns))
        place = {int(c): k for k, c in enumerate(columns)}
        for k in np.flatnonzero(keep):
            own = np.arange(ends[k], ends[k + 1])
            at = [place[int(c)] for c in own]
            part = table[:, own] @ factors[own]
            size = math.sqrt(float(weight @ part**2) / float(weight.sum()))
            sure = factors[own] @ np.linalg.pinv(covariance[np.ix_(at, at)]) @ factors[own] / len(own)
            keep[k] = size > matters and sure > _SURE**2
    return [factors[a:b] for a, b in pairwise(ends)]


def _rim(left: _Left, gain: GainMap, middle: NDArray[np.float64], lattice: Lattice) -> NDArray[np.float64]:
    """Polynomials of the rim after a pass; those of no significance are none."""
    parts = len(middle)
    # Window or direction without rim: no say.
    weight = left.rim_down.ravel()
    angle = np.tile(np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS, parts)
    degree = _RIM_DEGREE if parts > 2 * terms(_RIM_DEGREE) else 0
    field = np.repeat(monomials(middle, lattice, degree), _DIRECTIONS, axis=0)
    old = np.zeros((1 + 2 * _HARMONICS, terms(degree)))
    old[: gain.rim.shape[0], : gain.rim.shape[1]] = gain.rim[:, : old.shape[1]]
    waves = [np.ones(len(angle))]
    for k in range(1, _HARMONICS + 1):
        waves += [np.cos(k * angle), np.sin(k * angle)]
    target = left.rim_up.ravel() / np.maximum(weight, 1e-30)
    rows: list[list[int]] = [[0]] + [[2 * k - 1, 2 * k] for k in range(1, _HARMONICS + 1)]
    blocks, where = [], []
    for k, pair in enumerate(rows):
        # The mean rim of the whole field is the profile's.
        columns = range(field.shape[1]) if k <= _CHANGING else range(1)
        cells = [(row, c) for row in pair for c in columns if not (k == 0 and c == 0)]
        if cells:
            blocks.append(np.column_stack([waves[row] * field[:, c] for row, c in cells]))
            where.append(cells)
    # What is already in the map is fitted again, so that it can be found to be of no significance.
    for block, cells in zip(blocks, where, strict=True):
        target = target + block @ np.array([old[cell] for cell in cells])
    factors = _significant(blocks, np.where(weight > 0, target, 0.0), weight, _MATTERS)
    rim = np.zeros_like(old)
    for values, cells in zip(factors, where, strict=True):
        for value, cell in zip(values, cells, strict=True):
            rim[cell] = value
    last = max([0] + [k for k in range(1, _HARMONICS + 1) if np.any(rim[2 * k - 1 : 2 * k + 1])])
    return rim[: 1 + 2 * last]


def _cut(left: _Left, gain: GainMap) -> NDArray[np.float64]:
    """The cutting disc after a pass."""
    normal = left.cut_normal + np.tril(left.cut_normal, -1).T
    normal += 1e-6 * np.trace(normal) * np.eye(5) + 1e-12 * np.eye(5)
    radius, soft = gain.cut[3:]
    # Steps that a straight line cannot vouch for are shortened.
    most = np.array([1, 1, 1, 1, 0.3]) * soft
    cut = gain.cut + np.clip(np.linalg.solve(normal, left.cut_right), -most, most)
    cut[3], cut[4] = max(cut[3], 0.3 * radius), np.clip(cut[4], 0.2, 0.2 + 0.1 * radius)
    return cut


def _shade(left: _Left, gain: GainMap, middle: NDArray[np.float64], lattice: Lattice) -> NDArray[np.float64]:
    """Polynomials of the shading after a pass."""
    parts = len(middle)
    degree = _SHADE_DEGREE if parts > 2 * terms(_SHADE_DEGREE) else 1 if parts > 2 * terms(1) else 0
    field = monomials(middle, lattice, degree)
    shade = np.zeros((5, field.shape[1]))
    shade[:, : gain.shade.shape[1]] = gain.shade[:, : field.shape[1]]
    # The light of a window is a nuisance, the mean curvature is the profile's.
    own = np.maximum(left.normal[:, 5, 5], 1e-30)
    mixed = left.normal[:, :5, 5]
    normal = left.normal[:, :5, :5] - mixed[:, :, None] * mixed[:, None, :] / own[:, None, None]
    right = left.right[:, :5] - mixed * (left.right[:, 5] / own)[:, None]
    cells = [(row, c) for row in range(5) for c in range(field.shape[1] if row < 2 else min(6, field.shape[1]))]
    design = np.zeros((parts, 5, len(cells)))
    for k, (row, c) in enumerate(cells):
        design[:, row, k] = field[:, c]
    round_ = np.array([1.0 * (cell in ((2, 0), (4, 0))) for cell in cells])
    matter = np.einsum("wap,wab,wbq->pq", design, normal, design, optimize=True)
    force = np.einsum("wap,wa->p", design, right)
    matter += np.outer(round_, round_) * np.trace(matter) + (1e-9 * np.trace(matter) + 1e-12) * np.eye(len(cells))
    change = np.linalg.solve(matter, force)
    for value, cell in zip(change, cells, strict=True):
        shade[cell] += value
    return shade
