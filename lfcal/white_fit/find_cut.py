"""Discs that cut the microimages of a white image: whether there are any, and their fit."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from ..lattice.robust_fit import SIGNIFICANT, TUKEY_CUTOFF, robust_sigma
from ..microimage.fit import Fit, add_distortion, converge
from ..runtime.arrays import ENOUGH_PIXELS, Floats, evenly
from ..runtime.errors import CalibrationError
from .disc_light import BLUR, CORRELATION, COUNT, CUT, GAP, RADIUS, SHADING, TAIL
from .lenses import Lenses, cut_out, measure_centroid_offset
from .microimages import Microimages, compare_pixels
from .two_discs import LEAST_BLUR, CutMicroimages, choose_lens, displace, interchange

__all__ = [
    "CENTROIDS",
    "cost_ratio",
    "find_cut",
    "find_doubt",
    "fit_two_discs",
    "measure_narrowing",
]

# Where the fit starts: growth of the lattice and of the displacement of the second disc, and radii
# of both, over the radius of whole microimages. Of two equal discs the lattice follows the middle;
# a disc that cuts only the corners leaves it to the lenses.
_STARTS = np.array([(-0.15, 0.3, 1.02, 1.08), (0, 0.2, 1, 1.2), (0, -0.2, 1, 1.2)])
# Expected parameters, and the standard deviations by which they may differ.
_EXPECTED = ((SHADING, 0.02, 0.3), (GAP, 0.0, 0.1), (TAIL, 0.0, 0.03), (CORRELATION, 0.3, 0.5))
_RADIUS_RANGE = 0.3
_BLUR_RANGE = (0.5, 0.01)
# Lenses and pixels of the first fits, and pixels of the last one.
_FIRST_LENSES = 400
_FIRST_PIXELS = 10_000
_LAST_PIXELS = 150_000
# Pixels, and fewest lenses, that two discs are fitted to.
_DISCS = 8e5, 250
# [px] A disc cuts microimages if it reaches into those in the corners by more than this.
_LEAST_CUT = 0.3
# Robust squared residuals with two discs over those without, up to which the discs are believed.
_MOST_COST = 0.999
#: [px] Centroids farther from the lattice than this are doubtful.
CENTROIDS = 0.2
# [px] Centres with a larger standard error are doubtful.
_MOST_ERROR = 0.03
# Relative error of the blur that both edges share: no model is more exact.
_MODEL_FAULT = 0.02
# Least slope of the profile, over the steepest one, of pixels that locate an edge.
_STEEP = 0.1


def find_cut(
    tones: StackedCrops, plain: Fit[Microimages], bent: Fit[Microimages]
) -> Fit[CutMicroimages] | None:
    """The discs that cut each other, if the microimages are narrower along the field than across.

    `plain` has no distortion that is not known, `bent` has one if it is significant, of any kind.
    """
    narrowing, error = measure_narrowing(bent.lenses)
    if narrowing < SIGNIFICANT * error:
        return None
    try:
        fit = fit_two_discs(cut_out(tones, plain.lattice, *_DISCS), plain)
    except (CalibrationError, ValueError):
        return None
    # A disc that stays outside the microimages cuts nothing.
    if fit.lenses.depth < _LEAST_CUT:
        return None
    # Two discs must explain the pixels better than whole microimages of any profile.
    whole = [one.lenses.residuals() for one in (plain, bent)]
    cut, residual = _compare(fit, plain.lenses)
    if not cost_ratio(residual, *whole) < _MOST_COST:
        return None
    # Where nothing is cut, in the middle, centroids are those of the lenses.
    usual = measure_centroid_offset(plain.lenses)
    beside = measure_centroid_offset(cut)
    return None if beside > max(CENTROIDS, usual) else fit


def _converge(
    lattice: Lattice, discs: CutMicroimages, orders: tuple[str, ...]
) -> Fit[CutMicroimages]:
    """A fit to all lenses alike: cut ones in the corners lie farther from the lattice."""
    return converge(lattice, discs, orders, weigh_lenses=False)


def cost_ratio(own: Floats, *others: Floats) -> float:
    """Robust squared residual (m,) of one model over the least one of other models."""
    most = (TUKEY_CUTOFF * robust_sigma(own)) ** 2
    cost, *rest = (float(np.minimum(one**2, most).mean()) for one in (own, *others))
    return cost / max(min(rest), 1e-30)


def fit_two_discs(lenses: Lenses, plain: Fit[Microimages]) -> Fit[CutMicroimages]:
    """The two discs that explain the microimages best.

    CalibrationError or ValueError where no discs do. `lenses` lie on the lattice of `plain`, which was fitted without a cut.
    """
    orders = plain.orders or ("k1",)
    few = lenses.select(evenly(len(lenses.indices), _FIRST_LENSES))
    first = _start(few, plain.lenses).draw(_FIRST_PIXELS)
    begun = []
    for growth, apart, *radii in plain.lenses.radius * _STARTS:
        lattice = displace(add_distortion(plain.lattice), np.array([0, 0, growth]))
        shape = first.shape.copy()
        shape[CUT][2] = apart
        shape[RADIUS] = radii
        with suppress(CalibrationError, ValueError):
            discs = replace(first, expected=shape, shape=shape).at(lattice)
            begun.append(_converge(lattice, discs, orders))
    fit = min(begun, key=lambda one: np.abs(one.lenses.residuals()).mean())
    if not plain.orders and not _has_distortion(fit):
        orders = ()
        fit = replace(fit, lattice=replace(fit.lattice, distortion=None))
    fit = _converge(fit.lattice, replace(fit.lenses, soft=False), orders)
    discs = replace(fit.lenses, **lenses.given).at(fit.lattice)
    fit = _converge(fit.lattice, discs.draw(_LAST_PIXELS, near_edges=True), orders)
    if not choose_lens(fit.lenses, _shape_covariance(fit))[0]:
        fit = _converge(*interchange(fit.lattice, fit.lenses), orders)
    # No model of the blur that both edges share is exact.
    shared = fit.step.covariance[:, CORRELATION - COUNT]
    fault = _MODEL_FAULT * shared / max(float(shared[CORRELATION - COUNT]), 1e-12)
    covariance = fit.step.covariance + np.outer(fault, fault)
    return replace(fit, step=replace(fit.step, covariance=covariance))


def _has_distortion(fit: Fit[CutMicroimages]) -> bool:
    """Whether the radial distortion of a fit is significant."""
    bend = fit.lattice.distortion
    place = fit.step.names.index("k1")
    error = math.sqrt(fit.step.covariance[place, place])
    return bend is not None and abs(bend.k1) > SIGNIFICANT * error


def _shape_covariance(fit: Fit[CutMicroimages]) -> Floats:
    """(12, 12) that of the shape of the discs."""
    return fit.step.covariance[-COUNT:, -COUNT:]


def find_doubt(fit: Fit[CutMicroimages]) -> str | None:
    """What is doubtful about the discs: which of them is the lens, or where its centre is."""
    _, doubt = choose_lens(fit.lenses, _shape_covariance(fit))
    error = fit.step.uncertainty
    if doubt is not None or error < _MOST_ERROR:
        return doubt
    return (
        "microimages are the overlap of two discs with soft edges "
        f"({fit.lenses.blur[0]:.2f} px): their centres are known to {error:.2f} px only; close the "
        "aperture of the main lens for a white image without vignetting"
    )


def _compare(fit: Fit[CutMicroimages], lenses: Lenses) -> tuple[CutMicroimages, Floats]:
    """The discs on some `lenses`, and residuals (m,) of all pixels, over the gains of `lenses`."""
    discs = replace(fit.lenses, **lenses.given).at(fit.lattice).draw(lenses.light.size)
    for _ in range(2):
        sums = discs.sums()
        gains = sums.right[:, -1] / np.maximum(sums.normal[:, -1, -1], 1e-30)
        discs = discs.learn_levels(np.clip(gains, -0.5, 1), fit.lattice)
    seen = discs.compare()
    return discs, seen.residual * (discs.gain / lenses.gain)[seen.lens]


def _start(lenses: Lenses, plain: Microimages) -> CutMicroimages:
    """Lenses with discs that are expected beside a `plain` fit, but for their radii."""
    expected = np.zeros(COUNT)
    spread = np.zeros(COUNT)
    spread[CUT] = plain.radius * np.array([0.3, 0.3, 0.5])
    for place, value, deviation in _EXPECTED:
        expected[place] = value
        spread[place] = deviation
    spread[RADIUS] = _RADIUS_RANGE * plain.radius
    slope = np.abs(plain.rings.table[:, 1]).max()
    blur = plain.core / max(slope * math.sqrt(2 * math.pi), 1e-9)
    expected[BLUR][0] = math.log(max(blur, 2 * LEAST_BLUR))
    spread[BLUR] = _BLUR_RANGE
    gap = float(plain.profile.min() / max(plain.profile[0], 1e-9))
    expected[GAP] = min(max(gap, 0.0), 0.5)
    return CutMicroimages(
        **lenses.given,
        used=np.zeros(0, np.int64),
        steps=np.zeros((0, 2)),
        scale=plain.radius,
        expected=expected,
        spread=spread,
        shape=expected,
        soft=True,
    )


def measure_narrowing(lenses: Microimages) -> tuple[float, float]:
    """By how much microimages in the corners are narrower along the field than across [px].

    Also returns the error.

    Amplitude of `cos(2 * angle)` of the radius, angles from the direction of the field, growing
    with the field: neither a lattice nor its distortion, neither blur nor the shape of pixels give
    whole discs any.
    """
    few = lenses.thin(ENOUGH_PIXELS)
    x, y = few.places()
    far = np.maximum(np.hypot(x, y), 1e-6)
    residual, inside, (slope, weight) = compare_pixels(few)
    # Only the lenses in the corners may be cut: their pixels are no outliers.
    largest = SIGNIFICANT / np.sqrt(weight)
    residual = np.clip(residual, -largest, largest)
    used = inside & (far < few.cell.inradius)
    used &= np.abs(slope) > _STEEP * np.abs(few.rings.table[:, 1]).max()
    field = few.field[:, :, None, None]
    reach = np.maximum(np.hypot(field[:, 0], field[:, 1]), 1e-6)
    along = (field[:, 0] * x + field[:, 1] * y) / (reach * far)
    response = slope * reach * (2 * along**2 - 1)
    information = float((used * weight * response**2).sum())
    if information <= 0:
        return 0.0, np.inf
    return float((used * weight * response * residual).sum()) / information, information**-0.5
