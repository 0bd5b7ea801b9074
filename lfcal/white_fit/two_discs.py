"""Two discs whose overlap is lit, fitted to pixels of some microimages in all of the field: a lens and what cuts it.

Both discs are displaced in proportion to the position in the field, and by one radial distortion. Each has a radius, a
blur of its edge and a shading about its centre; where their edges run alike they may be blurred together or one by one
(`correlation`, as in `kernel`). Neighbours add their light. Levenberg-Marquardt (Marquardt 1963), with a free gain for
each lens. The model is the same with the two discs interchanged: `choose_lens` decides which of them is the lens.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..lattice.lattice import Lattice
from ..lattice.robust_fit import TUKEY_CUTOFF
from ..runtime.fastmath import FAST
from ..runtime.kernels.jit import kernel
from .kernel import light_through_both
from .model import TwoDiscs, WhiteModel, field_position
from .normal_equations import Microimages
from .settings import TWO_DISCS, TwoDiscSettings
from .shading import fit_gain_slope

__all__ = ["choose_lens", "fit_two_discs", "remove_neighbours"]

# Places of the parameters in the vector that is fitted; those of the second disc follow those of the first.
_OFFSET, _OTHER_OFFSET, _GROWTH, _BEND, _RADIUS, _LOG_BLUR, _SHADING = 0, 2, 4, 6, 7, 9, 11
_GAP, _TAIL, _CORRELATION, _SHEAR, _COUNT = 13, 14, 15, 16, 19
_ROOT_HALF = math.sqrt(0.5)
_ROOT_TAU = math.sqrt(2 * math.pi)
_TAU = 2 * math.pi
# Depths [blur] beyond which an edge lets all or nothing through.
_DEEPEST = 3.5
_STEPS = np.array([(i, j) for j in (-1, 0, 1) for i in (-1, 0, 1) if (i, j) != (0, 0)])


@dataclass(frozen=True)
class _Pixels:
    """Pixels of some lenses."""

    place: NDArray[np.float64]  # (n, 2) [px] relative to the centre on the lattice
    lens: NDArray[np.int64]  # (n,) number of the lens
    light: NDArray[np.float64]  # (n,) over the gain of the lens
    field: NDArray[np.float64]  # (lenses, 2)
    steps: NDArray[np.float64]  # (8, 2) [px] to neighbours
    scale: float  # [px] about the radius of the discs
    reach: float  # [px] half the diagonal of the flat


def fit_two_discs(lenses: Microimages, lattice: Lattice, settings: TwoDiscSettings = TWO_DISCS) -> TwoDiscs | None:
    """The two discs that explain the microimages best, in any order; None where there are none.

    `lenses` have been fitted without a cut, on `lattice`.
    """
    some = np.unique(np.linspace(0, len(lenses.centres) - 1, min(len(lenses.centres), settings.lenses)).astype(int))
    slope = lenses.slope[some]
    expected = _start(lenses, settings)
    p = expected
    spread = np.array(
        [np.inf] * _RADIUS
        + [settings.radius_spread * lenses.radius] * 2
        + [settings.blur_spread] * 2
        + [settings.shading_spread] * 2
        + [settings.gap_spread, 0.0, 0.0, np.inf, np.inf, np.inf]
    )
    try:
        # First without what only matters near the end, on few pixels.
        for count, more in (
            (settings.first_pixels, (0.0, 0.0)),
            (settings.pixels, (settings.tail_spread, settings.correlation_spread)),
        ):
            spread[[_TAIL, _CORRELATION]] = more
            pixels = _choose_pixels(lenses, some, slope, lattice, count)
            p, gain, covariance = _fit(pixels, p, expected, spread, settings)
            # The gains of cut microimages had been fitted without a cut, and the slope of the light with them.
            slope = fit_gain_slope(lenses.centres[some], lenses.gain[some] * np.maximum(gain, 1e-3), lattice)
    except np.linalg.LinAlgError:
        return None

    variances = np.diag(covariance) + 1e-30

    def error_of_difference(k: int) -> float:
        return float(np.sqrt(max(variances[k] + variances[k + 1] - 2 * covariance[k, k + 1], 0.0)))

    return TwoDiscs(
        offset=p[_OFFSET:_GROWTH].reshape(2, 2),
        growth=p[_GROWTH:_BEND],
        bend=float(p[_BEND]),
        radius=p[_RADIUS:_LOG_BLUR],
        blur=np.exp(p[_LOG_BLUR:_SHADING]),
        shading=p[_SHADING:_GAP],
        gap=float(p[_GAP]),
        tail=float(p[_TAIL]),
        correlation=float(p[_CORRELATION]),
        shear=p[_SHEAR:],
        scale=lenses.radius,
        radius_error=error_of_difference(_RADIUS),
        shading_error=error_of_difference(_SHADING),
        bend_error=float(np.sqrt(variances[_BEND])),
        correlation_error=float(np.sqrt(variances[_CORRELATION])),
    )


def _start(lenses: Microimages, settings: TwoDiscSettings) -> NDArray[np.float64]:
    """Parameters to start from: two like discs, displaced to both sides of the lattice through their middles."""
    radius, blur = lenses.radius, lenses.blur[0] if lenses.blur else 0.0
    p = np.zeros(_COUNT)
    p[_GROWTH : _GROWTH + 2] = settings.start_growth * radius * np.array([-0.5, 0.5])
    p[_RADIUS : _RADIUS + 2] = radius * np.array(settings.start_radii)
    p[_LOG_BLUR : _LOG_BLUR + 2] = math.log(max(blur, settings.start_blur))
    p[_SHADING : _SHADING + 2] = settings.start_shading
    p[_GAP] = min(max(lenses.gap / max(float(lenses.profile[0]), 1e-9), 0.0), 0.5)
    p[_CORRELATION] = settings.start_correlation
    return p


def _choose_pixels(
    lenses: Microimages,
    some: NDArray[np.int64],
    slope: NDArray[np.float64],
    lattice: Lattice,
    count: int,
) -> _Pixels:
    """At most `count` of the unclipped pixels in the cells of `some` lenses with this slope of the light."""
    light, side = lenses.light[some], np.arange(lenses.light.shape[1])
    offset = (lenses.corners - lenses.centres)[some]
    place = np.empty((*light.shape, 2))
    place[..., 0] = side[None, None, :] + offset[:, 0, None, None]
    place[..., 1] = side[None, :, None] + offset[:, 1, None, None]
    keep = (np.abs(place @ lenses.normals.T).max(-1) <= 0.5) & (light < lenses.saturation)
    number = np.broadcast_to(np.arange(len(some))[:, None, None], light.shape)[keep]
    place, bright = place[keep], light[keep].astype(np.float64)
    if len(bright) > count:
        taken = np.sort(np.random.default_rng(0).permutation(len(bright))[:count])
        number, place, bright = number[taken], place[taken], bright[taken]
    bright /= lenses.gain[some][number] * (1 + (slope[number] * place).sum(1)) * max(float(lenses.profile[0]), 1e-9)
    field = field_position(lenses.centres[some], lattice)
    reach = float(np.hypot(*lattice.image_size) / 2)
    return _Pixels(place, number, bright, field, _STEPS @ lattice.basis, lenses.radius, reach)


def _fit(
    pixels: _Pixels,
    p: NDArray[np.float64],
    expected: NDArray[np.float64],
    spread: NDArray[np.float64],
    settings: TwoDiscSettings,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Parameters, from `p` on, gains of the lenses, and covariance of the parameters.

    `spread` are the standard deviations by which parameters differ from the `expected` ones; 0 holds them fixed.
    """
    free = np.flatnonzero(spread > 0)
    weight, damping = np.ones(len(pixels.light)), settings.damping
    variance = cost = np.inf
    for turn in range(settings.passes):
        residual, table, gain = _residuals(pixels, p, weight, free)
        stiff = _prior(p, spread, settings)[np.ix_(free, free)]
        if turn >= settings.plain_passes:
            limit = TUKEY_CUTOFF * 1.4826 * float(np.median(np.abs(residual))) + 1e-12
            weight = np.maximum(1 - (residual / limit) ** 2, 0) ** 2
        variance, away = float((weight * residual**2).sum() / weight.sum()), (p - expected)[free]
        before = float((weight * residual**2).sum() + variance * (away @ stiff @ away))
        normal = (table * weight[:, None]).T @ table + variance * stiff
        force = table.T @ (weight * residual) - variance * stiff @ away
        for _ in range(settings.tries):
            step = np.zeros(_COUNT)
            step[free] = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), force)
            trial = _bounded(p + step, pixels.scale, settings)
            left = _residuals(pixels, trial, weight)[0]
            off = (trial - expected)[free]
            cost = float((weight * left**2).sum() + variance * (off @ stiff @ off))
            if cost < before:
                break
            damping *= 8
        else:
            break
        p, damping = trial, damping / 8
        if before - cost < settings.converged * before and turn > settings.plain_passes:
            break
    residual, table, gain = _residuals(pixels, p, weight, free)
    covariance = np.zeros((_COUNT, _COUNT))
    covariance[np.ix_(free, free)] = variance * np.linalg.inv((table * weight[:, None]).T @ table + variance * stiff)
    return p, gain, covariance


def _prior(p: NDArray[np.float64], spread: NDArray[np.float64], settings: TwoDiscSettings) -> NDArray[np.float64]:
    """(19, 19) information that is known before: `spread`, and blurs of both edges that are alike, or else differ."""
    prior = np.diag(1 / np.where(spread > 0, spread, np.inf) ** 2)
    both, differ = slice(_LOG_BLUR, _LOG_BLUR + 2), p[_LOG_BLUR + 1] - p[_LOG_BLUR]
    # Weight of a Cauchy distribution: a clear difference is believed.
    alike = 1 / (settings.blur_difference**2 * (1 + (differ / settings.blur_unlike) ** 2))
    prior[both, both] += alike * np.array([[1, -1], [-1, 1]])
    return prior


def _bounded(p: NDArray[np.float64], scale: float, settings: TwoDiscSettings) -> NDArray[np.float64]:
    """The parameters within what is possible."""
    p = p.copy()
    for first, low, high in (
        (_RADIUS, settings.least_radius * scale, settings.most_radius * scale),
        (_LOG_BLUR, math.log(settings.least_blur), math.log(settings.most_blur * scale)),
    ):
        p[first : first + 2] = np.clip(p[first : first + 2], low, high)
    p[_TAIL] = np.clip(p[_TAIL], settings.least_tail, settings.most_tail)
    p[_CORRELATION] = np.clip(p[_CORRELATION], 0.0, settings.most_correlation)
    return p


def _residuals(
    pixels: _Pixels, p: NDArray[np.float64], weight: NDArray[np.float64], free: NDArray[np.int64] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Residuals (n,), their negative derivatives (n, f) with the `free` parameters, and gains (lenses,) eliminated."""
    count, lens = len(pixels.field), pixels.lens
    model = np.empty(len(lens))
    table = np.zeros((len(lens) if free is not None else 0, _COUNT))
    _evaluate(pixels.place, lens, pixels.field, pixels.steps, p, pixels.scale, pixels.reach, True, model, table)
    square = np.bincount(lens, weight * model * model, count) + 1e-12
    gain = np.bincount(lens, weight * pixels.light * model, count) / square
    residual = pixels.light - gain[lens] * model
    if free is None:
        return residual, table, gain
    table = table[:, free]
    for column in table.T:
        column -= model * (np.bincount(lens, weight * model * column, count) / square)[lens]
        column *= gain[lens]
    return residual, table, gain


def choose_lens(discs: TwoDiscs, settings: TwoDiscSettings = TWO_DISCS) -> TwoDiscs:
    """The discs with that one first which is the lens, and the doubt about it.

    The lens is whole in the middle of the field, where the other disc must not show: it is the smaller one. Shading is
    centred on the lens. Radii are compared if they differ beyond their errors, else shadings; what is left of an error
    of the model of the edges grows with their blur.
    """
    blur = float(discs.blur.mean())
    smaller = (discs.radius[1] - discs.radius[0]) / math.hypot(discs.radius_error, settings.radius_fault * blur)
    leaking = settings.shading_fault * (blur / discs.scale) ** 2
    shaded = (discs.shading[0] - discs.shading[1]) / math.hypot(discs.shading_error, leaking)
    sign, sure = smaller if abs(smaller) > settings.sure else smaller + shaded, settings.sure
    chosen = discs if sign >= 0 else discs.interchanged()
    clash = abs(smaller) > sure and abs(shaded) > sure and smaller * shaded < 0
    if abs(sign) > sure and not clash:
        return chosen
    return replace(chosen, doubt=_state_doubt(chosen, clash))


def _state_doubt(discs: TwoDiscs, clash: bool) -> str:
    apart = abs(discs.growth[1] - discs.growth[0])
    why = "the smaller one is not the one that its shading is centred on" if clash else "they are alike"
    return (
        f"microimages are the overlap of two discs of {discs.radius[0]:.2f} and {discs.radius[1]:.2f} px radius, and "
        f"{why}: the first is taken for the lens; if the other is, centres lie up to {apart:.2f} px off in the corners "
        "(a scale of the lattice, and a constant in the disparity); close the aperture of the main lens for a white "
        "image without vignetting"
    )


def remove_neighbours(lenses: Microimages, model: WhiteModel) -> Microimages:
    """The lenses, which are cut as in `model`, without the light that neighbours add to them."""
    lattice, discs = model.lattice, model.discs
    assert discs is not None
    p = np.zeros(_COUNT)
    field = field_position(lenses.centres, lattice)
    # One displacement for all: that of each lens from what the field tells is far below a pixel.
    design = np.column_stack([np.ones(len(field)), field])
    shift = np.linalg.lstsq(design, lenses.cut_offset, rcond=None)[0]
    p[_OTHER_OFFSET : _OTHER_OFFSET + 2], p[_GROWTH + 1] = shift[0], 0.5 * (shift[1, 0] + shift[2, 1])
    p[_RADIUS : _RADIUS + 2], p[_LOG_BLUR : _LOG_BLUR + 2] = discs.radius, np.log(discs.blur)
    p[_SHADING : _SHADING + 2], p[_GAP:_SHEAR] = discs.shading, (discs.gap, discs.tail, discs.correlation)
    steps = _STEPS @ lattice.basis
    nearest = float(np.hypot(*steps.T).min())
    reach = nearest - float(discs.radius.min() + _DEEPEST * discs.blur.max()) - abs(p[_GROWTH + 1])
    side = np.arange(lenses.light.shape[1])
    offset = lenses.corners - lenses.centres
    x, y = side[None, None, :] + offset[:, 0, None, None], side[None, :, None] + offset[:, 1, None, None]
    near = np.hypot(x, y) > reach
    number, row, column = np.nonzero(near)
    place = np.column_stack([column + offset[number, 0], row + offset[number, 1]])
    spilt, table = np.empty(len(place)), np.zeros((0, _COUNT))
    half = float(np.hypot(*lattice.image_size) / 2)
    _evaluate(place, number, field, steps, p, discs.scale, half, False, spilt, table)
    peak = lenses.gain * float(lenses.profile[0])
    light = lenses.light.copy()
    light[near] -= (spilt - discs.gap) * peak[number]
    return replace(lenses, light=light, gap=discs.gap * float(lenses.profile[0]))


@kernel(error_model="numpy", share=lambda place, *_: len(place), fastmath=FAST)
def _evaluate(begin, end, place, lens, field, steps, p, scale, reach, own, model, table):
    """Light (n,) of pixels, with that of the lens itself only if `own`.

    If `table` (n, 19) has rows, also its derivatives with all parameters.
    """
    learn, per_square, per_reach = len(table) > 0, 1 / (scale * scale), 1 / reach
    gap, tail, correlation = p[_GAP], p[_TAIL], p[_CORRELATION]
    height, sharp = 1 - gap, np.exp(-p[_LOG_BLUR : _LOG_BLUR + 2])
    for k in range(begin, end):
        row = np.zeros(_COUNT)
        total = 0.0
        x, y, far, alpha = np.empty(2), np.empty(2), np.empty(2), np.empty(2)
        depth, light, slope = np.empty(2), np.empty(2), np.empty(2)
        for neighbour in range(0 if own else 1, len(steps) + 1):
            px, py, fx, fy = place[k, 0], place[k, 1], field[lens[k], 0], field[lens[k], 1]
            if neighbour:
                sx, sy = steps[neighbour - 1, 0], steps[neighbour - 1, 1]
                px, py, fx, fy = px - sx, py - sy, fx + sx * per_reach, fy + sy * per_reach
            cubic = fx * fx + fy * fy
            dark = False
            for disc in range(2):
                out = p[_GROWTH + disc] + p[_BEND] * cubic
                x[disc] = px - p[2 * disc] - fx * (out + p[_SHEAR]) - fy * (p[_SHEAR + 1] - p[_SHEAR + 2])
                y[disc] = py - p[2 * disc + 1] - fy * (out - p[_SHEAR]) - fx * (p[_SHEAR + 1] + p[_SHEAR + 2])
                far[disc] = math.sqrt(x[disc] * x[disc] + y[disc] * y[disc]) + 1e-9
                alpha[disc] = (p[_RADIUS + disc] - far[disc]) * sharp[disc]
                if alpha[disc] < -_DEEPEST:
                    dark = True
                    break
            if dark:
                continue
            for disc in range(2):
                a = min(alpha[disc], _DEEPEST)
                depth[disc] = a + tail * (a * a - 3) * a
                light[disc], slope[disc] = 1.0, 0.0
                if alpha[disc] < _DEEPEST:
                    light[disc] = 0.5 * (1 + math.erf(depth[disc] * _ROOT_HALF))
                    slope[disc] = math.exp(-0.5 * depth[disc] * depth[disc]) / _ROOT_TAU
            joint, with_first, with_second, turning = light[0] * light[1], light[1], light[0], 0.0
            if slope[0] > 0 and slope[1] > 0:
                along = (x[0] * x[1] + y[0] * y[1]) / (far[0] * far[1])
                alike = correlation * along
                joint, with_first, with_second = light_through_both(depth[0], depth[1], light[0], light[1], alike)
                apart = 1 / (1 - alike * alike)
                cross = depth[0] * depth[0] - 2 * alike * depth[0] * depth[1] + depth[1] * depth[1]
                turning = along * math.exp(-0.5 * cross * apart) * math.sqrt(apart) / _TAU
            near, other = far[0] * far[0] * per_square, far[1] * far[1] * per_square
            even = 1 - p[_SHADING] * near - p[_SHADING + 1] * other
            total += even * joint
            if not learn:
                continue
            for disc in range(2):
                push = slope[disc] * (with_second if disc else with_first) * height * even
                pull = push * (1 + 3 * tail * (alpha[disc] * alpha[disc] - 1)) * sharp[disc]
                rest = pull / far[disc] + 2 * height * joint * p[_SHADING + disc] * per_square
                gx, gy = rest * x[disc], rest * y[disc]
                row[2 * disc] += gx
                row[2 * disc + 1] += gy
                grows = gx * fx + gy * fy
                row[_GROWTH + disc] += grows
                row[_BEND] += grows * cubic
                row[_SHEAR] += gx * fx - gy * fy
                row[_SHEAR + 1] += gx * fy + gy * fx
                row[_SHEAR + 2] += gy * fx - gx * fy
                row[_RADIUS + disc] += pull
                row[_LOG_BLUR + disc] -= pull * (p[_RADIUS + disc] - far[disc])
                row[_TAIL] += push * (alpha[disc] * alpha[disc] - 3) * alpha[disc]
            row[_SHADING] -= height * joint * near
            row[_SHADING + 1] -= height * joint * other
            row[_CORRELATION] += turning * height * even
        model[k] = gap + height * total
        if learn:
            row[_GAP] = 1 - total
            for c in range(_COUNT):
                table[k, c] = row[c]
