"""Least squares of white images whose microimages a second disc cuts: the kernel of `disc_model` with that disc."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from ..lattice.cell import clip_rows, is_outside_cell
from ..runtime.fastmath import FAST
from .whole_kernel import OUTLIER

__all__ = ["accumulate_cut"]

# Beyond so many standard deviations from its middle the cut is all or nothing.
_EDGE = 3.0
# Edges that run alike are never blurred quite alike.
_MOST_SHARED = 0.98
# Gauss-Legendre nodes and their weights, for correlations up to the limit (to 1e-4 of the light) and beyond it.
_FEW_NODES = ((-0.7745966692414834, 5 / 18), (0.0, 8 / 18), (0.7745966692414834, 5 / 18))
_NODES = (
    (-0.9324695142031521, 0.17132449237917036 / 2), (-0.6612093864662645, 0.3607615730481386 / 2),
    (-0.2386191860831969, 0.46791393457269104 / 2), (0.2386191860831969, 0.46791393457269104 / 2),
    (0.6612093864662645, 0.3607615730481386 / 2), (0.9324695142031521, 0.17132449237917036 / 2),
)  # fmt: skip
_LOOSE = 0.8
_ROOT_HALF = math.sqrt(0.5)
_TAU = 2 * math.pi
_ROOT_TAU = math.sqrt(_TAU)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST, forceinline=True)
def _both(alpha, beta, first, second, shared):
    """Light through two edges at once, in units of their blur, and its change with each of them over that alone.

    `first` and `second` is the light through one of them.

    `shared` is the correlation of a bivariate normal distribution: 0 where the edges cross at a right angle or are
    blurred one after the other, 1 where they run alike and are blurred together. Gauss-Legendre quadrature of
    the derivative with the correlation (Drezner and Wesolowsky, J. Stat. Comput. Simul. 35, 1990).
    """
    squares, product = -0.5 * (alpha * alpha + beta * beta), alpha * beta
    total = 0.0
    if abs(shared) < _LOOSE:
        for k in range(3):
            r = 0.5 * shared * (1 + _FEW_NODES[k][0])
            over = 1 / (1 - r * r)
            total += _FEW_NODES[k][1] * math.exp((squares + r * product) * over) * math.sqrt(over)
    else:
        for k in range(6):
            r = 0.5 * shared * (1 + _NODES[k][0])
            over = 1 / (1 - r * r)
            total += _NODES[k][1] * math.exp((squares + r * product) * over) * math.sqrt(over)
    joint = first * second + shared * total / _TAU
    per_root = _ROOT_HALF / math.sqrt(1 - shared * shared)
    with_first = 0.5 * (1 + math.erf((beta - shared * alpha) * per_root))
    with_second = 0.5 * (1 + math.erf((alpha - shared * beta) * per_root))
    return joint, with_first, with_second


@njit(cache=True, nogil=True, error_model="numpy", parallel=True, fastmath=FAST)
def accumulate_cut(
    light, corners, centres, cut, gain, trust, tilt, radius, soft, faces, inner, reach, step, tables, edge, calm, thin,
    aside, shared, steep, dark, full, chunks, normal, right, mixed, band, scatter,
):  # fmt: skip
    """Add up all lenses; `tables` (r, 5) are level, slope, weight, four and depths, `band` (chunks, r, 8) as `by_ring`.

    Of each lens there are the seven local parameters, of which upper halves are filled. `steep` is the shape of the
    blur of an edge (`edge_blur`).
    """
    lenses, side = light.shape[0], light.shape[1]
    per_step, per_soft, even, within = 1 / step, 1 / soft, calm * calm, inner * inner
    most = OUTLIER * OUTLIER
    clear, shut = max(radius - _EDGE * soft, 0.0), radius + _EDGE * soft
    clear, shut = clear * clear, shut * shut
    for chunk in prange(chunks):
        g, pull, products = np.zeros(7), np.zeros(7), np.zeros((7, 7))
        for lens in range(chunk * lenses // chunks, (chunk + 1) * lenses // chunks):
            cx, cy = centres[lens, 0] - corners[lens, 0], centres[lens, 1] - corners[lens, 1]
            bright, belief, tilt_x, tilt_y = 1 / gain[lens], trust[lens], tilt[lens, 0], tilt[lens, 1]
            cut_x, cut_y = cut[lens, 0], cut[lens, 1]
            xx = xy = yy = xm = ym = mm = bx = by = bm = total = number = 0.0
            pull[:] = 0.0
            products[:] = 0.0
            top, bottom = clip_rows(cy, reach, 0, side)
            for y in range(top, bottom):
                dy = y - cy
                low_x, high_x = clip_rows(cx, math.sqrt(max(reach * reach - dy * dy, 0.0)), 0, side)
                for x in range(low_x, high_x):
                    dx = x - cx
                    square = max(dx * dx + dy * dy, 1e-12)
                    ex, ey = dx - cut_x, dy - cut_y
                    away = ex * ex + ey * ey
                    on_edge = clear < away < shut
                    share = 1.0
                    if square < even and not on_edge:
                        if (x + aside * y) & (thin - 1):
                            continue
                        share = float(thin)
                    elif square > within and is_outside_cell(dx, dy, faces):
                        continue
                    over = 1 / math.sqrt(square)
                    place = square * over * per_step
                    ring = int(place)
                    after = place - ring
                    here = 1 - after
                    up = ring + 1
                    turn = dx * dy * over * over
                    angle = 1 - 8 * turn * turn
                    disc = tables[ring, 0] * here + tables[up, 0] * after - dark
                    disc += (tables[ring, 3] * here + tables[up, 3] * after) * angle
                    through, change, depth, inward, per_far = 1.0, 0.0, 0.0, 0.0, 0.0
                    if on_edge:
                        per_far = 1 / math.sqrt(max(away, 1e-12))
                        inward = (radius - away * per_far) * per_soft
                        depth = inward + steep * (inward * inward - 3) * inward
                        through = 0.5 * (1 + math.erf(depth * _ROOT_HALF))
                        change = math.exp(-0.5 * depth * depth) * per_soft / _ROOT_TAU
                        change *= 1 + 3 * steep * (inward * inward - 1)
                    elif away >= shut:
                        through = 0.0
                    falling, cutting, turning = through, 1.0, 0.0
                    if on_edge and edge[ring]:
                        along_both = (dx * ex + dy * ey) * over * per_far
                        alike = min(max(shared * along_both, -_MOST_SHARED), _MOST_SHARED)
                        alpha = tables[ring, 4] * here + tables[up, 4] * after
                        own = 0.5 * (1 + math.erf(alpha * _ROOT_HALF))
                        joint, falling, cutting = _both(alpha, depth, own, through, alike)
                        per_own = 1 / own
                        through = joint * per_own
                        cutting *= per_own
                        apart = 1 / (1 - alike * alike)
                        cross = alpha * alpha - 2 * alike * alpha * depth + depth * depth
                        turning = along_both * math.exp(-0.5 * cross * apart) * math.sqrt(apart) * per_own / _TAU
                    model = dark + disc * through
                    residual = light[lens, y, x] * bright / (1 + tilt_x * dx + tilt_y * dy) - model
                    w = tables[ring, 2] * here + tables[up, 2] * after
                    chi = residual * residual * w
                    if light[lens, y, x] >= full and (residual < 0 or chi < 1):
                        continue
                    off = chi * belief / most
                    total += share * min(chi, most / belief)
                    number += share
                    if off >= 1:
                        continue
                    band[chunk, ring, 6] += residual * residual * belief
                    band[chunk, ring, 7] += 1
                    w *= (1 - off) * (1 - off) * belief * share
                    along = -(tables[ring, 1] * here + tables[up, 1] * after) * falling * over
                    gx, gy = along * dx, along * dy
                    wr, before, beyond = w * residual, falling * here, falling * after
                    band[chunk, ring, 3] += w
                    turned = angle * through
                    band[chunk, ring, 4] += turned * here * wr
                    band[chunk, up, 4] += turned * after * wr
                    band[chunk, ring, 5] += w * turned * turned * here
                    band[chunk, up, 5] += w * turned * turned * after
                    band[chunk, ring, 0] += w * before * before
                    band[chunk, up, 0] += w * beyond * beyond
                    band[chunk, ring, 1] += w * before * beyond
                    band[chunk, ring, 2] += before * wr
                    band[chunk, up, 2] += beyond * wr
                    if on_edge:
                        push = disc * change * cutting
                        g[2], g[3] = push * ex * per_far, push * ey * per_far
                        g[0], g[1], g[6] = gx + g[2], gy + g[3], model
                        g[4], g[5] = push, disc * turning
                        for a in range(7):
                            wa = w * g[a]
                            pull[a] += g[a] * wr
                            mixed[lens, a, ring] += wa * before
                            mixed[lens, a, up] += wa * beyond
                            for b in range(7):
                                products[a, b] += wa * g[b]
                        continue
                    wx, wy, wm = w * gx, w * gy, w * model
                    if falling > 0:
                        mixed[lens, 0, ring] += wx * before
                        mixed[lens, 0, up] += wx * beyond
                        mixed[lens, 1, ring] += wy * before
                        mixed[lens, 1, up] += wy * beyond
                        mixed[lens, 6, ring] += wm * before
                        mixed[lens, 6, up] += wm * beyond
                    xx += wx * gx
                    xy += wx * gy
                    yy += wy * gy
                    xm += wx * model
                    ym += wy * model
                    mm += wm * model
                    bx += gx * wr
                    by += gy * wr
                    bm += model * wr
            for a in range(7):
                right[lens, a] = pull[a]
                for b in range(a, 7):
                    normal[lens, a, b] = products[a, b]
            normal[lens, 0, 0] += xx
            normal[lens, 0, 1] += xy
            normal[lens, 1, 1] += yy
            normal[lens, 0, 6] += xm
            normal[lens, 1, 6] += ym
            normal[lens, 6, 6] += mm
            right[lens, 0] += bx
            right[lens, 1] += by
            right[lens, 6] += bm
            scatter[lens, 0], scatter[lens, 1] = total, number
