"""Light of a microimage that is the overlap of two discs with soft edges, and its derivatives.

Where both edges fall on the same pixels, the light depends on the blur that they share: nothing of
it where each disc is blurred by itself and what they let through multiplies, all of it where the
overlap of both is blurred. It is a bivariate normal probability. Tails of the blur may be longer or
shorter than normal: the depth in the edge has a third Hermite polynomial (Cornish and Fisher 1938).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ..runtime.kernels import kernel

__all__ = ["BLUR", "CORRELATION", "COUNT", "CUT", "GAP", "RADIUS", "SHADING", "TAIL", "evaluate"]

# Places of the parameters. Displacement of the second disc from the first one: x, y in the middle
# of the field [px], growth towards the corners [px]; radii [px]; logarithm of the blur of the first
# disc [px], and how much larger that of the second one is; shadings; light in the gaps; tail of the
# blur; correlation of the edges.
CUT = slice(0, 3)
RADIUS = slice(3, 5)
BLUR = slice(5, 7)
SHADING = slice(7, 9)
GAP = 9
TAIL = 10
CORRELATION = 11
COUNT = 12
# Places of those of the first disc; those of the second one follow.
_FIRST_RADIUS = RADIUS.start
_FIRST_BLUR = BLUR.start
_FIRST_SHADING = SHADING.start
# Places of the parameters in a row of derivatives, where those with the centre come first.
_CUT = 2
_RADIUS = _CUT + _FIRST_RADIUS
_BLUR = _CUT + _FIRST_BLUR
_SHADING = _CUT + _FIRST_SHADING
_GAP = _CUT + GAP
_TAIL = _CUT + TAIL
_CORRELATION = _CUT + CORRELATION
_ROOT_HALF = math.sqrt(0.5)
_TAU = 2 * math.pi
# Depths [blur] beyond which an edge lets all or nothing through.
_DEEPEST = 3.5
# Gauss-Legendre nodes and weights.
_NODES = np.polynomial.legendre.leggauss(6)
_NODE_PLACES = 0.5 * (1 + _NODES[0])
_NODE_WEIGHTS = 0.5 * _NODES[1]


@njit(error_model="numpy", fastmath=False)
def _through_both(alpha, beta, first, second, correlation):
    """Light through two edges at once, and its derivatives.

    Each derivative is relative to that of one edge alone.

    `alpha` and `beta` are the depths inside the edges in units of their blur, `first` and `second`
    the light through one alone. Drezner and Wesolowsky (J. Stat. Comput. Simul. 35, 1990).
    """
    squares = -0.5 * (alpha * alpha + beta * beta)
    product = alpha * beta
    total = 0.0
    for k in range(len(_NODE_PLACES)):
        r = correlation * _NODE_PLACES[k]
        over = 1 / (1 - r * r)
        total += _NODE_WEIGHTS[k] * math.exp((squares + r * product) * over) * math.sqrt(over)
    per_root = _ROOT_HALF / math.sqrt(1 - correlation * correlation)
    with_first = 0.5 * (1 + math.erf((beta - correlation * alpha) * per_root))
    with_second = 0.5 * (1 + math.erf((alpha - correlation * beta) * per_root))
    return first * second + correlation * total / _TAU, with_first, with_second


@njit(error_model="numpy", fastmath=False)
def _through_edge(alpha, tail):
    """Depth in an edge with this tail, light through it, and its derivative with the depth."""
    if alpha >= _DEEPEST:
        return _DEEPEST, 1.0, 0.0
    depth = alpha + tail * (alpha * alpha - 3) * alpha
    return (
        depth,
        0.5 * (1 + math.erf(depth * _ROOT_HALF)),
        math.exp(-0.5 * depth * depth) / math.sqrt(_TAU),
    )


@njit(error_model="numpy", fastmath=False)
def _add_lens(px, py, fx, fy, p, sharp, scale, discs, row):
    """Light at `px, py` from a lens at `fx, fy` of the field, without the light of gaps.

    Its derivatives are added to `row`.

    `sharp` (2,) is one over the blurs, `discs` (2, 7) working memory.
    """
    tail = p[TAIL]
    height = 1 - p[GAP]
    even = 1.0
    for disc in range(2):
        x = px - disc * (p[0] + fx * p[2])
        y = py - disc * (p[1] + fy * p[2])
        far = math.sqrt(x * x + y * y) + 1e-9
        alpha = (p[_FIRST_RADIUS + disc] - far) * sharp[disc]
        if alpha < -_DEEPEST:
            return 0.0
        depth, light, slope = _through_edge(alpha, tail)
        discs[disc, 0], discs[disc, 1], discs[disc, 2], discs[disc, 3] = x, y, far, alpha
        discs[disc, 4], discs[disc, 5], discs[disc, 6] = depth, light, slope
        even -= p[_FIRST_SHADING + disc] * far * far / (scale * scale)
    first = discs[0, 5]
    second = discs[1, 5]
    joint = first * second
    with_first = second
    with_second = first
    turning = 0.0
    if discs[0, 6] > 0 and discs[1, 6] > 0:
        one = discs[0, 4]
        two = discs[1, 4]
        along = (discs[0, 0] * discs[1, 0] + discs[0, 1] * discs[1, 1]) / (
            discs[0, 2] * discs[1, 2]
        )
        alike = p[CORRELATION] * along
        joint, with_first, with_second = _through_both(one, two, first, second, alike)
        apart = 1 / (1 - alike * alike)
        cross = one * one - 2 * alike * one * two + two * two
        turning = along * math.exp(-0.5 * cross * apart) * math.sqrt(apart) / _TAU
    for disc in range(2):
        x = discs[disc, 0]
        y = discs[disc, 1]
        far = discs[disc, 2]
        alpha = discs[disc, 3]
        shading = p[_FIRST_SHADING + disc] / (scale * scale)
        push = discs[disc, 6] * (with_second if disc else with_first) * height * even
        pull = push * (1 + 3 * tail * (alpha * alpha - 1)) * sharp[disc]
        rest = pull / far + 2 * height * joint * shading
        gx = rest * x
        gy = rest * y
        row[0] += gx
        row[1] += gy
        row[_CUT] += disc * gx
        row[_CUT + 1] += disc * gy
        row[_CUT + 2] += disc * (gx * fx + gy * fy)
        row[_RADIUS + disc] += pull
        softer = -push * (1 + 3 * tail * (alpha * alpha - 1)) * alpha
        row[_BLUR] += softer
        row[_BLUR + 1] += disc * softer
        row[_TAIL] += push * (alpha * alpha - 3) * alpha
        row[_SHADING + disc] -= height * joint * far * far / (scale * scale)
    row[_CORRELATION] += turning * height * even
    return even * joint


@kernel(error_model="numpy", share=lambda place, *_: len(place))
def evaluate(begin, end, place, lens, field, steps, p, scale, reach, table):
    """Derivatives of the light of pixels (n, 15) with the centre, the parameters and the gain.

    The last one is the light itself. The light of the neighbours at `steps` is included.

    `place` (n, 2) [px] is relative to the centre of the lens with number `lens` (n,), which lies at
    `field` (lenses, 2); `reach` is half the diagonal of the flat and `scale` a length for the
    shading [px].
    """
    discs = np.empty((2, 7))
    row = np.empty(_CUT + COUNT)
    sharp = np.array([math.exp(-p[_FIRST_BLUR]), math.exp(-p[_FIRST_BLUR] - p[_FIRST_BLUR + 1])])
    for k in range(begin, end):
        row[:] = 0.0
        fx = field[lens[k], 0]
        fy = field[lens[k], 1]
        total = _add_lens(place[k, 0], place[k, 1], fx, fy, p, sharp, scale, discs, row)
        for neighbour in range(len(steps)):
            sx = steps[neighbour, 0]
            sy = steps[neighbour, 1]
            x = place[k, 0] - sx
            y = place[k, 1] - sy
            u = fx + sx / reach
            v = fy + sy / reach
            total += _add_lens(x, y, u, v, p, sharp, scale, discs, row)
        row[_GAP] = 1 - total
        for c in range(_CUT + COUNT):
            table[k, c] = row[c]
        table[k, _CUT + COUNT] = p[GAP] + (1 - p[GAP]) * total
