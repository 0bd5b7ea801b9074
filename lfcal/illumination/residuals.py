"""Residuals of a gain map: pixels of a sample of lenses minus the map, summed over distance, direction and field.

Of every pixel the residual is `v / g - m`, with its luminance `v`, the light `g` of its lens and the relative light `m`
of the map. The light of a lens is fitted to its inner part first; on scene captures with a plane, and lenses that are
no plane there have little weight. The sums are normal equations of the terms of the map.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..gain.gain_map import GainMap
from ..gain.kernel import RIM_START, evaluate_shape, relative_light
from ..lattice.cell import Cell, is_outside_cell
from ..lattice.lattice import Lattice
from ..runtime.kernels import FAST, kernel
from .sample import Sample

__all__ = ["DIRECTIONS", "GainResiduals", "ResidualOptions", "collect_residuals"]

_ROOT_TAU = math.sqrt(2 * math.pi)
# Bins of the direction.
DIRECTIONS = 48


class ResidualOptions(NamedTuple):
    """Which pixels are compared, and how.

    Parameters
    ----------
    core : float [px]
        Radius within which the light of a lens is measured.
    scene : bool
        Whether the flat is a scene capture; the light of a lens is then a plane.
    brightest : float
        Luminance from which on pixels count as clipped.
    largest_square : (k,) float64
        Largest squared residual, by distance, of pixels that are not left out.
    terms : bool
        Whether the sums for rim, cut and shading are wanted; else these are zero.
    """

    core: float
    scene: bool
    brightest: float
    largest_square: NDArray[np.float64]
    terms: bool


class GainResiduals(NamedTuple):
    """Sums of residuals by window of the field; normal equations in their lower halves.

    Parameters
    ----------
    rings : (4, w, k) float64
        Over the distance to the centre: right side and weight of the change of the profile, sum of squared residuals,
        sum of weights.
    normal, right : (w, 6, 6), (w, 6) float64
        Normal equations of the factors of `u, v, u^2, u*v, v^2, 1` of the shading.
    rims : (2, w, d) float64
        Right side and weight of the change of the rim [px] in each direction.
    dark : (w, 2) float64
        Sum of residuals, and of weights, outside the cutting disc.
    cut_normal, cut_right : (w, 5, 5), (w, 5) float64
        Normal equations of the cutting disc.
    """

    rings: NDArray[np.float64]
    normal: NDArray[np.float64]
    right: NDArray[np.float64]
    rims: NDArray[np.float64]
    dark: NDArray[np.float64]
    cut_normal: NDArray[np.float64]
    cut_right: NDArray[np.float64]


@njit(error_model="numpy")
def _fit_lens_light(picture, cx, cy, shift, rows, stride, options, lens, shape):
    """Light of a lens, its relative slope in x and y [1/px], and its weight: 0 if it is clipped or too steep."""
    profile, step, cut = shape.profile, shape.step, shape.cut
    core, scene = options.core, options.scene
    light = across = down = whole = wide = high = squares = 0.0
    count, clipped = 0, 0
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
            clipped += v >= options.brightest
            light += s * v
            whole += s * s
            # In a disc about the centre, light and slopes are hardly correlated.
            across += s * dx * v
            down += s * dy * v
            wide += s * s * dx * dx
            high += s * s * dy * dy
            squares += v * v
    if count < 4 or light <= 0 or clipped * 20 > count:
        return 1.0, 0.0, 0.0, 0.0
    if not scene:
        return light / whole, 0.0, 0.0, 1.0
    left = max(squares - light * light / whole - across * across / wide - down * down / high, 0.0) / count
    light, gx, gy = light / whole, across / wide, down / high
    if (gx * gx + gy * gy) * core * core > light * light:
        return 1.0, 0.0, 0.0, 0.0
    # Lenses with little contrast beside a plane, relative to its light, show the rim best.
    contrast = 0.06 * 0.06
    return light, gx / light, gy / light, contrast / (contrast + left / (light * light))


@njit(error_model="numpy")
def _add_equation(features, count, weight, e, normal, right):
    """Add a pixel to the normal equations, lower half, of `count` unknowns."""
    for a in range(count):
        right[a] += weight * features[a] * e
        for b in range(a + 1):
            normal[a, b] += weight * features[a] * features[b]


@njit(error_model="numpy")
def _differentiate_cut(ex, ey, field_x, field_y, s, through, plane, cut, features):
    """Derivatives of the light of a pixel by shift (2), growth, radius and softness of the cutting disc."""
    far = math.sqrt(ex * ex + ey * ey)
    depth = (cut[3] - far) / cut[4]
    push = (s - cut[5]) / through * math.exp(-0.5 * depth * depth) / (_ROOT_TAU * cut[4]) * plane
    features[0], features[1] = push * ex / far, push * ey / far
    features[2] = features[0] * field_x + features[1] * field_y
    features[3], features[4] = push, -push * depth


@kernel(error_model="numpy", share=lambda picture, sample, *_: len(sample.first) - 1, fastmath=FAST)
def _add_residuals(begin, end, picture, sample, cell, options, shape, slope, sums):
    """Add the pixels of all lenses of a sample to the sums; `slope` (k,) is the derivative of the profile."""
    centres, places, first, stride = sample.centres, sample.places, sample.first, sample.stride
    faces, inner, reach = cell.normals, cell.inradius, cell.circumradius
    scene, limit, terms = options.scene, options.largest_square, options.terms
    radius, profile, step, cut = shape.radius, shape.profile, shape.step, shape.cut
    rings, normal, right, rims, dark, cut_normal, cut_right = sums
    field = shape.frame
    for window in range(begin, end):
        powers, lens, features = np.empty(64), np.empty(RIM_START + shape.rim.shape[0]), np.empty(6)
        for n in range(first[window], first[window + 1]):
            cx, cy = centres[n, 0], centres[n, 1]
            evaluate_shape(cx, cy, shape, powers, lens)
            px, py = places[n, 0], places[n, 1]
            # Other pixels are left out in each lens. The content of a scene differs little from row to row.
            rows = 2 * stride if scene else stride
            shift = n % rows
            gain, gx, gy, share = _fit_lens_light(picture, px, py, shift, rows, stride, options, lens, shape)
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
                    if through < 0.02:
                        # Stray light alone.
                        dark[window, 0] += share * e
                        dark[window, 1] += share
                    place = stretched / step
                    ring = min(int(place), len(profile) - 2)
                    part = min(place - ring, 1.0)
                    if e * e > limit[ring]:
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
                        _differentiate_cut(dx - lens[5], dy - lens[6], fx, fy, s, through, plane, cut, features)
                        _add_equation(features, 5, share, e, cut_normal[window], cut_right[window])
                    steep = (slope[ring] * (1 - part) + slope[ring + 1] * part) * through * plane * r / radius
                    if abs(steep) > 0.02:
                        d = math.floor(math.atan2(dy, dx) / (2 * math.pi) * DIRECTIONS + 0.5) % DIRECTIONS
                        rims[0, window, d] -= share * steep * e
                        rims[1, window, d] += share * steep * steep
                    elif s > 0.7 and through > 0.95 and not scene:
                        u, w = dx / radius, dy / radius
                        features[0], features[1], features[2] = s * u, s * w, s * u * u
                        features[3], features[4], features[5] = s * u * w, s * w * w, s
                        _add_equation(features, 6, share, e, normal[window], right[window])


def collect_residuals(
    picture: NDArray[np.float32], lattice: Lattice, gain: GainMap, sample: Sample, options: ResidualOptions
) -> GainResiduals:
    """Compare a sample of lenses with a gain map.

    Parameters
    ----------
    picture : (h, w) float32
        Square root of the luminance (`images.preprocessing`).
    lattice : Lattice [px]
    gain : GainMap
    sample : Sample
    options : ResidualOptions
    """
    windows, rings = len(sample.first) - 1, len(gain.profile)
    sums = GainResiduals(
        np.zeros((4, windows, rings)), np.zeros((windows, 6, 6)), np.zeros((windows, 6)),
        np.zeros((2, windows, DIRECTIONS)), np.zeros((windows, 2)), np.zeros((windows, 5, 5)), np.zeros((windows, 5)),
    )  # fmt: skip
    slope = np.gradient(gain.profile, gain.step)
    kernel: Any = _add_residuals
    kernel(picture, sample, Cell.of(lattice), options, gain.shape(lattice), slope, sums)
    return sums
