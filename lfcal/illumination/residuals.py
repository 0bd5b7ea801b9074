"""What a gain map leaves over of the pixels of a sample of lenses, collected over distance, direction and field."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ..gain.gain_map import GainMap
from ..gain.kernel import evaluate_shape, relative_light
from ..lattice.cell import cell_inradius, cell_normals, is_outside_cell
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops, sample_lenses, sample_mask
from ..runtime.fastmath import FAST

__all__ = ["DIRECTIONS", "OUTLIER", "GainResiduals", "Sample", "collect_residuals", "draw_sample"]

DIRECTIONS = 48
# Residuals beyond so many standard deviations have no say.
OUTLIER = 4.685
_ROOT_TAU = math.sqrt(2 * math.pi)
# The field is parted into so many windows at most, of so many lenses at least.
_WINDOWS = (8, 6)
_FEWEST = 6
# A microimage needs no more pixels than these to be compared; of larger ones rows and columns are left out.
_LENS_PIXELS = 700
_LENSES = 200
# Contrast, beside a plane, at which a lens of a scene counts half.
_SMOOTH = 0.06
# Numbers of a pixel's own factors in shading, and parameters of the cutting disc.
_SHADES, _CUTS = 6, 5


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
def _own_light(picture, cx, cy, shift, rows, stride, core, scene, brightest, lens, profile, step, cut):
    """Light of a lens, its relative slope in x and y [1/px], and its say; no say where it is clipped or unlike any."""
    moment, force = np.zeros((3, 3)), np.zeros(3)
    squares, count, clipped = 0.0, 0, 0
    for y in range(math.ceil(cy - core) + shift, math.floor(cy + core) + 1, rows):
        dy = y - cy
        half = math.sqrt(max(core * core - dy * dy, 0.0))
        for x in range(math.ceil(cx - half) + shift % stride, math.floor(cx + half) + 1, stride):
            dx = x - cx
            s = relative_light(dx, dy, lens, profile, step, cut)[0]
            if s < 0.5:
                continue
            v = picture[y, x] * picture[y, x]
            count += 1
            clipped += v >= brightest
            force[0] += s * v
            moment[0, 0] += s * s
            if scene:
                a, b = s * dx / core, s * dy / core
                moment[0, 1] += s * a
                moment[0, 2] += s * b
                moment[1, 1] += a * a
                moment[1, 2] += a * b
                moment[2, 2] += b * b
                force[1] += a * v
                force[2] += b * v
                squares += v * v
    if count < 4 or force[0] <= 0 or clipped * 20 > count:
        return 1.0, 0.0, 0.0, 0.0
    if not scene:
        return force[0] / moment[0, 0], 0.0, 0.0, 1.0
    gain, gx, gy = _solve3(moment, force)
    if gain <= 0 or gx * gx + gy * gy > gain * gain:
        return 1.0, 0.0, 0.0, 0.0
    left = max(squares - gain * force[0] - gx * force[1] - gy * force[2], 0.0) / count
    # Lenses that show little beside a plane, measured by its light, say what the rim is like.
    share = _SMOOTH * _SMOOTH / (_SMOOTH * _SMOOTH + left / (gain * gain))
    return gain, gx / (gain * core), gy / (gain * core), share


@njit(cache=True, nogil=True, error_model="numpy")
def _add(features, count, share, e, normal, right):
    """Add a pixel to normal equations of `count` unknowns, lower half."""
    for a in range(count):
        right[a] += share * features[a] * e
        for b in range(a + 1):
            normal[a, b] += share * features[a] * features[b]


@njit(cache=True, nogil=True, error_model="numpy")
def _push_of_cut(ex, ey, field_x, field_y, s, through, plane, cut, features):
    """How the light of a pixel changes with shift (2), growth, radius and softness of the cutting disc."""
    far = math.sqrt(ex * ex + ey * ey)
    depth = (cut[3] - far) / cut[4]
    push = (s - cut[5]) / through * math.exp(-0.5 * depth * depth) / (_ROOT_TAU * cut[4]) * plane
    features[0], features[1] = push * ex / far, push * ey / far
    features[2] = features[0] * field_x + features[1] * field_y
    features[3], features[4] = push, -push * depth


@njit(cache=True, nogil=True, error_model="numpy")
def _direction(dx, dy):
    """The bin of a direction is centred on it."""
    return math.floor(math.atan2(dy, dx) / (2 * math.pi) * DIRECTIONS + 0.5) % DIRECTIONS


@njit(cache=True, nogil=True, error_model="numpy", parallel=True, fastmath=FAST)
def _compare(
    picture, centres, places, first, stride, faces, inner, reach, core, scene, brightest, limit, field, radius,
    profile, step, shade, rim, cut, slope, terms, rings, normal, right, rims, sector, dark, cut_normal, cut_right,
):  # fmt: skip
    for window in prange(len(first) - 1):
        powers, lens, features = np.empty(64), np.empty(7 + rim.shape[0]), np.empty(6)
        for n in range(first[window], first[window + 1]):
            cx, cy = centres[n, 0], centres[n, 1]
            evaluate_shape(cx, cy, field, radius, shade, rim, cut, powers, lens)
            px, py = places[n, 0], places[n, 1]
            # Pixels left out are others in each lens. What a scene shows differs little from row to row.
            rows = 2 * stride if scene else stride
            shift = n % rows
            gain, gx, gy, share = _own_light(
                picture, px, py, shift, rows, stride, core, scene, brightest, lens, profile, step, cut
            )
            if share == 0:
                continue
            for y in range(math.ceil(py - reach) + shift, math.floor(py + reach) + 1, rows):
                dy = y - py
                half = math.sqrt(max(reach * reach - dy * dy, 0.0))
                for x in range(math.ceil(px - half) + (n // stride) % stride, math.floor(px + half) + 1, stride):
                    dx = x - px
                    r = math.sqrt(dx * dx + dy * dy)
                    if r > inner and is_outside_cell(dx, dy, faces):
                        continue
                    s, stretched, through = relative_light(dx, dy, lens, profile, step, cut)
                    plane = max(1 + gx * dx + gy * dy, 0.2)
                    e = picture[y, x] * picture[y, x] / gain - s * plane
                    if sector.shape[0] > 0:
                        d = _direction(dx, dy)
                        sector[window, d, 0] += share * e / plane
                        sector[window, d, 1] += share * (r < inner)
                    if through < 0.02:
                        dark[window, 0] += share * e
                        dark[window, 1] += share
                    place = stretched / step
                    ring = min(int(place), len(profile) - 2)
                    part = min(place - ring, 1.0)
                    if e * e > limit[window, ring]:
                        continue
                    rings[2, window, ring] += share * e * e
                    rings[3, window, ring] += share
                    if through > 0.5:
                        bright = share * through * plane
                        rings[0, window, ring] += bright * e * (1 - part)
                        rings[1, window, ring] += bright * through * plane * (1 - part)
                        rings[0, window, ring + 1] += bright * e * part
                        rings[1, window, ring + 1] += bright * through * plane * part
                    if not terms:
                        continue
                    if 0.001 < through < 0.999:
                        fx, fy = (cx - field[0]) / field[2], (cy - field[1]) / field[2]
                        _push_of_cut(dx - lens[5], dy - lens[6], fx, fy, s, through, plane, cut, features)
                        _add(features, _CUTS, share, e, cut_normal[window], cut_right[window])
                    steep = (slope[ring] * (1 - part) + slope[ring + 1] * part) * through * plane * r / radius
                    if abs(steep) > 0.02:
                        d = _direction(dx, dy)
                        rims[0, window, d] -= share * steep * e
                        rims[1, window, d] += share * steep * steep
                    elif s > 0.7 and through > 0.95 and not scene:
                        u, w = dx / radius, dy / radius
                        features[0], features[1], features[2] = s * u, s * w, s * u * u
                        features[3], features[4], features[5] = s * u * w, s * w * w, s
                        _add(features, _SHADES, share, e, normal[window], right[window])


@dataclass(frozen=True)
class Sample:
    """Whole lenses spread over the field, in the order of windows of it.

    Parameters
    ----------
    centres, places : (n, 2) float64 [px]
        On the flat, and in the picture to be read.
    first : (b * a + 1,) int64
        Where each window begins.
    shape : (int, int)
        Rows `b` and columns `a` of windows.
    stride : int
        Every so many rows and columns of a lens are compared.
    """

    centres: NDArray[np.float64]
    places: NDArray[np.float64]
    first: NDArray[np.int64]
    shape: tuple[int, int]
    stride: int

    @property
    def middle(self) -> NDArray[np.float64]:
        """(b * a, 2) mean place [px] of the lenses of each window."""
        return np.array([self.centres[a:b].mean(0) if b > a else (0, 0) for a, b in pairwise(self.first)])

    def some(self, every: int) -> Sample:
        """Every so many of the lenses."""
        first = (self.first + every - 1) // every
        return replace(
            self,
            centres=np.ascontiguousarray(self.centres[::every]),
            places=np.ascontiguousarray(self.places[::every]),
            first=first,
        )


def draw_sample(lattice: Lattice, pixels: float, parts: StackedCrops | None = None) -> Sample:
    """Sample of lenses, of those in parts if given, with about so many pixels to be compared, but never too few."""
    cell = abs(float(np.linalg.det(lattice.basis)))
    stride = max(1, int(math.sqrt(cell / _LENS_PIXELS)))
    margin = cell_normals(lattice)[1] + 1
    wanted = max(pixels * stride**2 / cell, _LENSES)
    if parts is None or parts.size == lattice.image_size:
        centres = sample_lenses(lattice, margin, wanted)[1]
        places = centres
    else:
        _, centres, part = parts.lenses(lattice, margin)
        places = centres - parts.offsets[part]
        chosen = sample_mask(len(centres), wanted / max(len(centres), 1))
        centres, places = centres[chosen], places[chosen]
    shrink = min(1.0, math.sqrt(len(centres) / (_FEWEST * _WINDOWS[0] * _WINDOWS[1])))
    shape = max(1, int(_WINDOWS[1] * shrink)), max(1, int(_WINDOWS[0] * shrink))
    size = np.array(lattice.image_size)
    column, row = np.minimum((centres + 0.5) / size * shape[::-1], np.array(shape[::-1]) - 1).astype(int).T
    window = row * shape[1] + column
    order = np.argsort(window, kind="stable")
    first = np.searchsorted(window[order], np.arange(shape[0] * shape[1] + 1))
    return Sample(
        np.ascontiguousarray(centres[order]), np.ascontiguousarray(places[order]), first.astype(np.int64), shape, stride
    )


@dataclass(frozen=True)
class GainResiduals:
    """What a map leaves over: the profile as it should be, and the rest by window of the field.

    Parameters
    ----------
    profile : (k,) float64
    ring_square, ring_count : (w, k) float64
        Sum of squared residuals, and pixels, over the distance to the centre.
    normal, right : (w, 6, 6), (w, 6) float64
        Normal equations of the factors of `u, v, u^2, u*v, v^2, 1`.
    rim_up, rim_down : (w, d) float64
        The rim lies `rim_up / rim_down` px outside of that of the map.
    sector : (w, d, 2) float64
        Sum of residuals, and pixels well inside; empty where not asked for.
    dark : float
        Light where the cutting disc lets none through.
    cut_normal, cut_right : (5, 5), (5,) float64
        Normal equations of the cutting disc.
    """

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


def collect_residuals(
    picture: NDArray[np.float32], lattice: Lattice, gain: GainMap, sample: Sample, core: float, scene: bool,
    brightest: float, limit: NDArray[np.float64], sectors: bool = False, terms: bool = True,
) -> GainResiduals:  # fmt: skip
    """Compare a sample of lenses with a map.

    Parameters
    ----------
    picture : (h, w) float32
        Square root of the luminance (`features.tone`).
    lattice : Lattice [px]
    gain : GainMap
    sample : Sample
    core : float [px]
        Radius within which the light of a lens is measured.
    scene : bool
        Whether lenses show something; their light is then a plane.
    brightest : float
        Light that has been clipped where many pixels of a lens share it.
    limit : (w, k) float64
        Pixels that are off by more, as a share of the light of the lens, have no say.
    sectors : bool
        Whether residuals are collected over directions whatever their distance.
    terms : bool
        Whether rim, cut and shading are asked for; else these are zero.
    """
    faces, reach = cell_normals(lattice)
    parts, rings = len(sample.first) - 1, len(gain.profile)
    sums = np.zeros((4, parts, rings))
    normal, right = np.zeros((parts, _SHADES, _SHADES)), np.zeros((parts, _SHADES))
    rims, sector = np.zeros((2, parts, DIRECTIONS)), np.zeros((parts * sectors, DIRECTIONS, 2))
    dark, cut_normal, cut_right = np.zeros((parts, 2)), np.zeros((parts, _CUTS, _CUTS)), np.zeros((parts, _CUTS))
    kernel: Any = _compare
    kernel(
        picture, sample.centres, sample.places, sample.first, sample.stride, faces, cell_inradius(faces), reach, core,
        scene, brightest, limit**2, *gain.shape(lattice), np.gradient(gain.profile, gain.step), terms, sums,
        normal, right, rims, sector, dark, cut_normal, cut_right,
    )  # fmt: skip
    up, down, square, count = sums
    normal += np.tril(normal, -1).transpose(0, 2, 1)
    pixels = down.sum(0)
    found = np.maximum(gain.profile + up.sum(0) / np.maximum(pixels, 1e-300), 0.0)
    # Rings hardly any pixel fell into are like those beside them.
    at, filled = np.arange(rings), pixels > 1e-3 * pixels.max()
    profile = np.interp(at, at[filled], found[filled]) if filled.any() else gain.profile
    behind, pixels_behind = dark.sum(0)
    gap = gain.dark + behind / pixels_behind if pixels_behind > 0 else float(profile.min())
    return GainResiduals(
        profile,
        square,
        count,
        normal,
        right,
        rims[0],
        rims[1],
        sector,
        max(float(gap), 0.0),
        cut_normal.sum(0),
        cut_right.sum(0),
    )
