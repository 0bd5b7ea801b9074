"""Normal equations of a white image's model, summed over the pixels of all lenses.

The model of a pixel is `gain * (1 + slope @ delta) * (profile(|delta|) + shade @ delta * own(|delta|))`, with a fourth
angular harmonic in the profile; `own` is the light above that of the border, where a neighbour is shaded the other way.
Where a second disc cuts the microimages (mechanical vignetting), the profile above the light of the gap is multiplied
by what passes that disc. Outliers are weighted down by Tukey's biweight.

One source serves both cases: Numba compiles the kernel once with `cut` given and once with None, and drops the other
branch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..lattice.cell import clip_rows, is_outside_cell
from ..runtime.fastmath import FAST
from ..runtime.kernels.jit import kernel
from .settings import PIXELS, SOLVER

__all__ = ["Cell", "Cut", "Profile", "Sums", "Windows", "accumulate", "light_through_both", "sum_by_ring"]

# Gauss-Legendre nodes and their weights, for correlations up to the limit (to 1e-4 of the light) and beyond it.
_THREE_NODES = ((-0.7745966692414834, 5 / 18), (0.0, 8 / 18), (0.7745966692414834, 5 / 18))
_SIX_NODES = (
    (-0.9324695142031521, 0.17132449237917036 / 2), (-0.6612093864662645, 0.3607615730481386 / 2),
    (-0.2386191860831969, 0.46791393457269104 / 2), (0.2386191860831969, 0.46791393457269104 / 2),
    (0.6612093864662645, 0.3607615730481386 / 2), (0.9324695142031521, 0.17132449237917036 / 2),
)  # fmt: skip
_THREE_NODES_UP_TO = 0.8
_ROOT_HALF = math.sqrt(0.5)
_TAU = 2 * math.pi
_ROOT_TAU = math.sqrt(_TAU)
_MAX_CORRELATION = SOLVER.most_correlation
_OUTLIER = PIXELS.outlier
_CUT_EDGE = PIXELS.cut_edge


class Windows(NamedTuple):
    """Windows of light and parameters of each lens (`Microimages`)."""

    light: NDArray[np.float32]
    corners: NDArray[np.int64]
    centres: NDArray[np.float64]
    gain: NDArray[np.float64]
    weight: NDArray[np.float64]
    slope: NDArray[np.float64]
    shade: NDArray[np.float64]


class Cell(NamedTuple):
    """Cell of a lens (`Microimages`)."""

    normals: NDArray[np.float64]
    inradius: float
    circumradius: float


class Profile(NamedTuple):
    """Radial profile."""

    step: float  # [px]
    rings: NDArray[np.float64]  # (r, 5) value, slope, weight, fourth harmonic, light above that of the border
    even_radius: float  # [px] up to here only some pixels are used:
    thin: int  # one in so many, a power of two,
    aside: int  # [px] rows shifted by this against each other
    saturation: float


class Cut(NamedTuple):
    """Cutting disc (`Microimages`, `CatEye`)."""

    offsets: NDArray[np.float64]  # (n, 2) [px]
    radius: float  # [px]
    blur: float  # [px]
    correlation: float
    tail: float  # of the blur (`estimate_edge_blur`)
    gap: float
    edge: NDArray[np.bool_]  # (r,)
    depth: NDArray[np.float64]  # (r,) `edge_depths`


class Sums(NamedTuple):
    """Output, of `p` local parameters: `x, y, gain`, or `x, y`, offset and radius of the cut, correlation, gain."""

    normal: NDArray[np.float64]  # (n, p, p)
    right: NDArray[np.float64]  # (n, p)
    coupling: NDArray[np.float64]  # (n, p or 1, r) between local parameters and the profile
    band: NDArray[np.float64]  # (chunks, r, 11 or 12), see `sum_by_ring`
    scatter: NDArray[np.float64]  # (n, 2) weighted squared residuals, and their number


@njit(error_model="numpy", fastmath=FAST, forceinline=True)
def light_through_both(alpha, beta, first, second, correlation):
    """Light through two edges at once, and its derivative with each of them over that of the edge alone.

    `alpha` and `beta` are the depths inside the edges in units of their blur, `first` and `second` the light through
    one alone. Bivariate normal distribution after Drezner and Wesolowsky (J. Stat. Comput. Simul. 35, 1990).
    """
    squares, product = -0.5 * (alpha * alpha + beta * beta), alpha * beta
    total = 0.0
    if abs(correlation) < _THREE_NODES_UP_TO:
        for k in range(3):
            r = 0.5 * correlation * (1 + _THREE_NODES[k][0])
            over = 1 / (1 - r * r)
            total += _THREE_NODES[k][1] * math.exp((squares + r * product) * over) * math.sqrt(over)
    else:
        for k in range(6):
            r = 0.5 * correlation * (1 + _SIX_NODES[k][0])
            over = 1 / (1 - r * r)
            total += _SIX_NODES[k][1] * math.exp((squares + r * product) * over) * math.sqrt(over)
    joint = first * second + correlation * total / _TAU
    per_root = _ROOT_HALF / math.sqrt(1 - correlation * correlation)
    with_first = 0.5 * (1 + math.erf((beta - correlation * alpha) * per_root))
    with_second = 0.5 * (1 + math.erf((alpha - correlation * beta) * per_root))
    return joint, with_first, with_second


@njit(error_model="numpy", fastmath=FAST, forceinline=True)
def _through_cut(inward, per_blur, tail, on_rim, alpha, correlation, along_both):
    """Light that passes the cut, and its derivatives with the profile, position and radius of the cut, and correlation.

    The place lies `inward` of the edge of the cut and, if `on_rim`, `alpha` inside that of the microimage, in units of
    the blur; `along_both` is the cosine between the two edges.
    """
    depth = inward + tail * (inward * inward - 3) * inward
    through = 0.5 * (1 + math.erf(depth * _ROOT_HALF))
    change = math.exp(-0.5 * depth * depth) * per_blur / _ROOT_TAU
    change *= 1 + 3 * tail * (inward * inward - 1)
    if not on_rim:
        return through, through, change, 0.0
    alike = min(max(correlation * along_both, -_MAX_CORRELATION), _MAX_CORRELATION)
    own = 0.5 * (1 + math.erf(alpha * _ROOT_HALF))
    joint, falling, cutting = light_through_both(alpha, depth, own, through, alike)
    per_own = 1 / own
    apart = 1 / (1 - alike * alike)
    cross = alpha * alpha - 2 * alike * alpha * depth + depth * depth
    turning = along_both * math.exp(-0.5 * cross * apart) * math.sqrt(apart) * per_own / _TAU
    return joint * per_own, falling, change * (cutting * per_own), turning


@njit(error_model="numpy", fastmath=FAST, forceinline=True)
def _add_to_band(band, ring, after, w, wr, angle, falling, through):
    """Add a pixel to the sums that `sum_by_ring` takes apart.

    Its light follows the profile by the factor `falling` and the harmonic by `through`, both 1 without a cut.
    """
    own, force = w * falling * falling, falling * wr
    turn = angle * through
    turned, own_turned = turn * wr, w * turn * turn
    band[ring, 0] += own
    band[ring, 1] += own * after
    band[ring, 2] += own * after * after
    band[ring, 3] += force
    band[ring, 4] += force * after
    band[ring, 5] += turned
    band[ring, 6] += turned * after
    band[ring, 7] += own_turned
    band[ring, 8] += own_turned * after


@kernel(error_model="numpy", share=lambda windows, cell, profile, cut, learn, sums: len(sums[3]), fastmath=FAST)
def accumulate(begin, end, windows, cell, profile, cut, learn, sums):
    """Add up all lenses into `sums`: upper halves of normal matrices; of the profile only to `learn` it."""
    light, corners, centres, gain, lens_weight, slope, shade = windows
    normals, inradius, circumradius = cell
    step, rings, even_radius, thin, aside, saturation = profile
    normal, right, coupling, band, scatter = sums
    count, side, chunks = light.shape[0], light.shape[1], band.shape[0]
    per_step, most = 1 / step, _OUTLIER * _OUTLIER
    per_most, even, within = 1 / most, even_radius * even_radius, inradius * inradius
    if cut is not None:
        offsets, radius, blur, correlation, tail, gap, edge, edge_depth = cut
        per_blur = 1 / blur
        clear, shut = max(radius - _CUT_EDGE * blur, 0.0), radius + _CUT_EDGE * blur
        clear, shut = clear * clear, shut * shut
    for chunk in range(begin, end):
        g, total = np.zeros(7), band[chunk]
        for lens in range(chunk * count // chunks, (chunk + 1) * count // chunks):
            cx, cy = centres[lens, 0] - corners[lens, 0], centres[lens, 1] - corners[lens, 1]
            per_gain, trust, slope_x, slope_y = 1 / gain[lens], lens_weight[lens], slope[lens, 0], slope[lens, 1]
            limit = most / trust
            xx = xy = yy = xm = ym = mm = bx = by = bm = squares = number = 0.0
            if cut is not None:
                cut_x, cut_y = offsets[lens, 0], offsets[lens, 1]
            top, bottom = clip_rows(cy, circumradius, 0, side)
            for y in range(top, bottom):
                dy = y - cy
                half = math.sqrt(max(circumradius * circumradius - dy * dy, 0.0))
                first, last = clip_rows(cx, half, 0, side)
                for x in range(first, last):
                    dx = x - cx
                    square = max(dx * dx + dy * dy, 1e-12)
                    on_edge = False
                    if cut is not None:
                        ex, ey = dx - cut_x, dy - cut_y
                        away = ex * ex + ey * ey
                        on_edge = clear < away < shut
                    share = 1.0
                    if square < even and not on_edge:
                        if (x + aside * y) & (thin - 1):
                            continue
                        share = float(thin)
                    elif square > within and is_outside_cell(dx, dy, normals):
                        continue
                    # One division for all: they take longer than the rest.
                    over = 1 / math.sqrt(square)
                    place = square * over * per_step
                    ring = int(place)
                    after = place - ring
                    here = 1 - after
                    up = ring + 1
                    turn = dx * dy * over * over
                    # cos(4 * direction)
                    angle = 1 - 8 * turn * turn
                    level = rings[ring, 0] * here + rings[up, 0] * after
                    harmonic = (rings[ring, 3] * here + rings[up, 3] * after) * angle
                    tilt = slope_x * dx + slope_y * dy
                    falling, through = 1.0, 1.0
                    if cut is None:
                        own = rings[ring, 4] * here + rings[up, 4] * after
                        model = level + harmonic + (shade[lens, 0] * dx + shade[lens, 1] * dy) * own
                        # 1 / (1 + tilt) by two steps of Newton's method.
                        inverse = 1 - tilt + tilt * tilt
                        inverse *= 2 - (1 + tilt) * inverse
                        inverse *= 2 - (1 + tilt) * inverse
                        residual = light[lens, y, x] * per_gain * inverse - model
                    else:
                        disc = level - gap + harmonic
                        moving, turning, per_far = 0.0, 0.0, 0.0
                        if on_edge:
                            alpha = edge_depth[ring] * here + edge_depth[up] * after
                            per_far = 1 / math.sqrt(max(away, 1e-12))
                            inward = (radius - away * per_far) * per_blur
                            along_both = (dx * ex + dy * ey) * over * per_far
                            through, falling, moving, turning = _through_cut(
                                inward, per_blur, tail, edge[ring], alpha, correlation, along_both
                            )
                        elif away >= shut:
                            through, falling = 0.0, 0.0
                        model = gap + disc * through
                        residual = light[lens, y, x] * per_gain / (1 + tilt) - model
                    ring_weight = rings[ring, 2] * here + rings[up, 2] * after
                    chi = residual * residual * ring_weight
                    if light[lens, y, x] >= saturation and (residual < 0 or chi < 1):
                        continue
                    squares += share * min(chi, limit)
                    number += share
                    off = chi * trust * per_most
                    if off >= 1:
                        continue
                    w = share * (ring_weight * (1 - off) * (1 - off) * trust)
                    along = -(rings[ring, 1] * here + rings[up, 1] * after) * falling * over
                    gx, gy = along * dx, along * dy
                    wx, wy, wm, wr = w * gx, w * gy, w * model, w * residual
                    if learn:
                        _add_to_band(total, ring, after, w, wr, angle, falling, through)
                        total[ring, 9] += residual * residual * trust
                        total[ring, 10] += 1
                        before, beyond = falling * here, falling * after
                        if cut is not None:
                            total[ring, 11] += w
                            if on_edge:
                                push = disc * moving
                                g[2], g[3] = push * ex * per_far, push * ey * per_far
                                g[0], g[1], g[6] = gx + g[2], gy + g[3], model
                                g[4], g[5] = push, disc * turning
                                for a in range(7):
                                    wa = w * g[a]
                                    right[lens, a] += g[a] * wr
                                    coupling[lens, a, ring] += wa * before
                                    coupling[lens, a, up] += wa * beyond
                                    for b in range(7):
                                        normal[lens, a, b] += wa * g[b]
                                continue
                            if falling > 0:
                                coupling[lens, 0, ring] += wx * before
                                coupling[lens, 0, up] += wx * beyond
                                coupling[lens, 1, ring] += wy * before
                                coupling[lens, 1, up] += wy * beyond
                        if falling > 0:
                            coupling[lens, -1, ring] += wm * before
                            coupling[lens, -1, up] += wm * beyond
                    xx += wx * gx
                    xy += wx * gy
                    yy += wy * gy
                    xm += wx * model
                    ym += wy * model
                    mm += wm * model
                    bx += gx * wr
                    by += gy * wr
                    bm += model * wr
            normal[lens, 0, 0] += xx
            normal[lens, 0, 1] += xy
            normal[lens, 1, 1] += yy
            normal[lens, 0, -1] += xm
            normal[lens, 1, -1] += ym
            normal[lens, -1, -1] += mm
            right[lens, 0] += bx
            right[lens, 1] += by
            right[lens, -1] += bm
            scatter[lens, 0], scatter[lens, 1] = squares, number


def sum_by_ring(band: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums (r, 8) for each ring of the profile from those (r, 11 or 12) of the pixels between two rings.

    Pixels lie `after` of the way from the ring below to the next. Columns of `band`: `w`, `w * after`, `w * after**2`;
    weighted residual, and that times `after`; the same two times `angle`; `w * angle**2`, and that times `after`;
    squared residuals; number; with a cut, the weight without its factor. Columns returned: own weight, weight shared
    with the next ring, right side, weight of all, right side and weight of the harmonic, squared residuals, number.
    """
    w, wa, waa, force, force_up, turned, turned_up, own, own_up, squares, count = band.T[:11]

    def shift(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([[0.0], values[:-1]])

    total = band[:, 11] if band.shape[1] > 11 else w
    return np.column_stack([
        w - 2 * wa + waa + shift(waa), wa - waa, force - force_up + shift(force_up), total,
        turned - turned_up + shift(turned_up), own - own_up + shift(own_up), squares, count,
    ])  # fmt: skip
