"""Least squares of white images whose microimages a second disc cuts: the kernel of `disc_model` with that disc."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from .disc_whole import OUTLIER
from .lens_cell import outside, rows_within

__all__ = ["accumulate_cut"]

# Beyond so many standard deviations from its middle the cut is all or nothing.
_EDGE = 3.0
# Edges that run alike are never blurred quite alike.
_MOST_SHARED = 0.98
_NODES = (
    -0.9324695142031521, -0.6612093864662645, -0.2386191860831969,
    0.2386191860831969, 0.6612093864662645, 0.9324695142031521,
)  # fmt: skip
_WEIGHTS = (
    0.17132449237917036, 0.3607615730481386, 0.46791393457269104,
    0.46791393457269104, 0.3607615730481386, 0.17132449237917036,
)  # fmt: skip
_ROOT_HALF = math.sqrt(0.5)
_ROOT_TAU = math.sqrt(2 * math.pi)


@njit(cache=True, nogil=True, error_model="numpy")
def _transmission(dx, dy, radius, soft):
    """Light through the cutting disc, its slope [1/px], distance to the disc's centre, depth in units of soft."""
    far = math.sqrt(dx * dx + dy * dy)
    depth = (radius - far) / soft
    if depth > _EDGE:
        return 1.0, 0.0, far, depth
    if depth < -_EDGE:
        return 0.0, 0.0, far, depth
    return 0.5 * (1 + math.erf(depth * _ROOT_HALF)), math.exp(-0.5 * depth * depth) / (_ROOT_TAU * soft), far, depth


@njit(cache=True, nogil=True, error_model="numpy")
def _both(alpha, beta, shared):
    """Light through two edges at once, in units of their blur, and its change with each of them over that alone.

    `shared` is the correlation of a bivariate normal distribution: 0 where the edges cross at a right angle or are
    blurred one after the other, 1 where they run alike and are blurred together. Six-point Gauss-Legendre quadrature of
    the derivative with the correlation (Drezner and Wesolowsky, J. Stat. Comput. Simul. 35, 1990).
    """
    first, second = 0.5 * (1 + math.erf(alpha * _ROOT_HALF)), 0.5 * (1 + math.erf(beta * _ROOT_HALF))
    total = 0.0
    for k in range(6):
        r = 0.5 * shared * (1 + _NODES[k])
        own = 1 - r * r
        total += (
            _WEIGHTS[k] * math.exp(-0.5 * (alpha * alpha - 2 * r * alpha * beta + beta * beta) / own) / math.sqrt(own)
        )
    joint = first * second + 0.5 * shared * total / (2 * math.pi)
    root = math.sqrt(1 - shared * shared)
    with_first = 0.5 * (1 + math.erf((beta - shared * alpha) / root * _ROOT_HALF))
    with_second = 0.5 * (1 + math.erf((alpha - shared * beta) / root * _ROOT_HALF))
    return joint, with_first, with_second


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def accumulate_cut(
    light, corners, centres, cut, gain, trust, tilt, radius, soft, faces, inner, reach, step, level, slope, weight,
    four, edge, calm, thin, aside, depths, shared, dark, full, chunks, normal, right, mixed, band, scatter,
):  # fmt: skip
    lenses, side = light.shape[0], light.shape[1]
    for chunk in prange(chunks):
        g = np.zeros(8)
        for lens in range(chunk * lenses // chunks, (chunk + 1) * lenses // chunks):
            cx, cy = centres[lens, 0] - corners[lens, 0], centres[lens, 1] - corners[lens, 1]
            top, bottom = rows_within(cy, reach, 0, side)
            for y in range(top, bottom):
                dy = y - cy
                low_x, high_x = rows_within(cx, np.sqrt(max(reach * reach - dy * dy, 0.0)), 0, side)
                for x in range(low_x, high_x):
                    dx = x - cx
                    rho = np.sqrt(dx * dx + dy * dy)
                    if rho > inner and outside(dx, dy, faces):
                        continue
                    place = rho / step
                    ring = int(place)
                    part = place - ring
                    ex, ey = dx - cut[lens, 0], dy - cut[lens, 1]
                    through, change, far, depth = _transmission(ex, ey, radius, soft)
                    share = 1.0
                    if rho < calm and change == 0:
                        if (x + aside * y) & (thin - 1):
                            continue
                        share = float(thin)
                    disc = level[ring] * (1 - part) + level[ring + 1] * part - dark
                    angle = 1 - 8 * (dx * dx) * (dy * dy) / max(rho * rho * rho * rho, 1e-12)
                    disc += (four[ring] * (1 - part) + four[ring + 1] * part) * angle
                    falling, cutting, turning = through, 1.0, 0.0
                    if change > 0 and edge[ring]:
                        along_both = (dx * ex + dy * ey) / max(rho * far, 1e-6)
                        alike = min(max(shared * along_both, -_MOST_SHARED), _MOST_SHARED)
                        alpha = depths[ring] * (1 - part) + depths[ring + 1] * part
                        own = 0.5 * (1 + math.erf(alpha * _ROOT_HALF))
                        joint, falling, cutting = _both(alpha, depth, alike)
                        through = joint / own
                        cutting /= own
                        cross = alpha * alpha - 2 * alike * alpha * depth + depth * depth
                        cross = math.exp(-0.5 * cross / (1 - alike * alike)) / math.sqrt(1 - alike * alike)
                        turning = along_both * cross / (2 * math.pi * own)
                    model = dark + disc * through
                    lit = gain[lens] * (1 + tilt[lens, 0] * dx + tilt[lens, 1] * dy)
                    residual = light[lens, y, x] / lit - model
                    w = weight[ring] * (1 - part) + weight[ring + 1] * part
                    chi = residual * residual * w
                    if light[lens, y, x] >= full and (residual < 0 or chi < 1):
                        continue
                    away = chi * trust[lens] / (OUTLIER * OUTLIER)
                    scatter[lens, 0] += share * min(chi, OUTLIER * OUTLIER / trust[lens])
                    scatter[lens, 1] += share
                    if away >= 1:
                        continue
                    band[chunk, ring, 6] += residual * residual * trust[lens]
                    band[chunk, ring, 7] += 1
                    w *= (1 - away) * (1 - away) * trust[lens] * share
                    along = -(slope[ring] * (1 - part) + slope[ring + 1] * part) * falling / max(rho, 1e-6)
                    g[0], g[1], g[7] = along * dx, along * dy, model
                    here, after = falling * (1 - part), falling * part
                    band[chunk, ring, 3] += w
                    turned = w * angle * through
                    band[chunk, ring, 4] += turned * (1 - part) * residual
                    band[chunk, ring + 1, 4] += turned * part * residual
                    band[chunk, ring, 5] += turned * angle * through * (1 - part)
                    band[chunk, ring + 1, 5] += turned * angle * through * part
                    band[chunk, ring, 0] += w * here * here
                    band[chunk, ring + 1, 0] += w * after * after
                    band[chunk, ring, 1] += w * here * after
                    band[chunk, ring, 2] += w * here * residual
                    band[chunk, ring + 1, 2] += w * after * residual
                    low = 7
                    if change > 0:
                        push = disc * change * cutting
                        g[2], g[3] = push * ex / max(far, 1e-6), push * ey / max(far, 1e-6)
                        g[0] += g[2]
                        g[1] += g[3]
                        g[4], g[5], g[6] = push, -push * depth, disc * turning
                        low = 2
                    for a in range(8):
                        if a >= 2 and a < low:
                            continue
                        right[lens, a] += w * g[a] * residual
                        mixed[lens, a, ring] += w * g[a] * here
                        mixed[lens, a, ring + 1] += w * g[a] * after
                        for b in range(a, 8):
                            if b >= 2 and b < low:
                                continue
                            normal[lens, a, b] += w * g[a] * g[b]
