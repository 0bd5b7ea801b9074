"""Fit of a white image: lattice and distortion, or two discs that cut each other, to the pixels of many lenses.

All lenses share one lattice and one radial profile; each has its own gain. A distortion is kept only if it is
significant and moves the centres. A few lenses find whether a disc cuts the microimages and, if so, some more give the
lattice of both discs; else as many as are needed give the final values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from ..lattice.lit_lenses import LitLenses
from ..lattice.residuals import Residuals
from ..lattice.robust_fit import TUKEY_CUTOFF
from ..lattice.standard_errors import LatticeErrors
from ..runtime.errors import CalibrationError
from .cat_eye import CatEye
from .gauss_newton import Fit, add_distortion, converge, distortion_orders, explains_better, locate_lenses
from .microimages import Microimages, cut_out
from .two_discs import TwoDiscs, choose_lens, fit_two_discs
from .vignetting import compare_pixels, measure_centroid_offset, measure_narrowing

__all__ = ["WhiteFit", "fit_white", "refine_on_parts"]

# [px] of centroids beside the lattice, from which on they are doubtful.
_CENTROIDS = 0.2
# Pixels, and fewest lenses, that a cut and a distortion are looked for with.
_SEARCH = 1e5, 150


@dataclass(frozen=True)
class WhiteFit:
    """A fitted lattice and how its microimages agree with it."""

    lattice: Lattice
    cat_eye: CatEye | None  # None where microimages are whole
    doubt: str | None  # why the centres may be others, and what to do
    residual_rms: float  # [px] robust RMS distance of single microimages from the lattice
    errors: LatticeErrors  # as the scatter of the microimages implies
    lenses_used: int
    half_difference: float  # [px] RMS distance over the flat between the fits of two halves of the microimages
    residuals: Residuals  # [px] of the single microimages that took part


def fit_white(tones: NDArray[np.float32] | StackedCrops, lattice: Lattice, pixels: float = 3.2e6) -> WhiteFit:
    """Fit a white image.

    Parameters
    ----------
    tones : (h, w) float32, or parts of such
        Square root of the light (`images.preprocessing.sqrt_luminance`).
    lattice : Lattice [px]
        Start, right to a fraction of the pitch over the whole flat. The orders of its distortion, if any, are kept.
    pixels : float
        Use at most as many lenses, evenly spread, as have so many pixels in all.

    Raises
    ------
    CalibrationError
        If fewer than a dozen whole microimages are on the flat, or they keep to no lattice.
    """
    tones, known = StackedCrops.of(tones), distortion_orders(lattice)
    lenses, lit = cut_out(tones, lattice, *_SEARCH, None, None)
    plain = converge(lattice, lenses, known)
    fit = _select_orders(plain)
    discs = _find_cut(tones, plain, fit, lit)
    if discs is not None:
        return _summarise_discs(discs, plain.lenses)
    if pixels > fit.lenses.pixels:
        lenses, lit = cut_out(tones, fit.lattice, pixels, 0, fit.lenses, lit)
        fit = _select_orders(converge(fit.lattice, lenses, fit.orders))
    residuals = Residuals(fit.lenses.indices.astype(np.int32), locate_lenses(fit).astype(np.float32))
    return WhiteFit(
        fit.lattice, None, _find_doubt(fit.lenses, fit.lattice),
        fit.step.residual_rms, LatticeErrors(tuple(fit.step.names), fit.step.covariance),
        int((fit.step.weight > 0).sum()), fit.step.half_difference(), residuals,
    )  # fmt: skip


def refine_on_parts(tones: StackedCrops, lattice: Lattice) -> Lattice:
    """The lattice fitted to some lenses of parts of a flat, with a distortion if it is significant.

    `tones` are square roots of the light; the lattice is right to a fraction of the pitch in these parts. Raises
    `CalibrationError` as `fit_white`.
    """
    fit = converge(lattice, cut_out(tones, lattice, *_SEARCH, None, None)[0], distortion_orders(lattice))
    return _select_orders(fit).lattice


def _try(fit: Fit, orders: tuple[str, ...]) -> Fit:
    """The fit with these distortion `orders` if they explain the microimages better, else as it is."""
    if set(orders) <= set(fit.orders) or not explains_better(fit, orders):
        return fit
    try:
        return converge(add_distortion(fit.lattice, "general" in orders), fit.lenses, orders)
    except (CalibrationError, ValueError):
        return fit


def _select_orders(fit: Fit) -> Fit:
    """The fit with a radial distortion, and a general one, as far as they are significant."""
    return _try(_try(fit, ("k1",)) if not fit.orders else fit, ("general",))


def _find_cut(tones: StackedCrops, plain: Fit, bent: Fit, lit: LitLenses) -> TwoDiscs | None:
    """The discs that cut each other, if the microimages are narrower along the field than across.

    `plain` has no distortion that is not known, `bent` has one if it is significant, of any kind.
    """
    narrowing, error = measure_narrowing(bent.lenses, bent.lattice)
    # A cut by one pixel narrows microimages by 0.2 px.
    if narrowing < max(0.01, 6 * error):
        return None
    lenses, _ = cut_out(tones, plain.lattice, 8e5, 250, plain.lenses, lit)
    discs = fit_two_discs(lenses, plain.lattice)
    if discs is None:
        return None
    discs = choose_lens(discs)
    # Where nothing is cut, in the middle, centroids are those of the lenses.
    beside = measure_centroid_offset(plain.lenses, discs.lens_lattice())
    astray = beside > max(_CENTROIDS, measure_centroid_offset(plain.lenses, plain.lattice))
    # A disc that stays outside the microimages cuts nothing.
    return None if astray or discs.depth < 0.3 or not _explains_more(discs, plain, bent) else discs


def _explains_more(discs: TwoDiscs, plain: Fit, bent: Fit) -> bool:
    """Whether the discs explain the pixels better than whole microimages of any profile, distorted or not, do."""
    by_discs = discs.residuals(plain.lenses)
    most = (TUKEY_CUTOFF * 1.4826) ** 2 * float(np.median(np.abs(by_discs))) ** 2
    cost = [float(np.minimum(by_discs**2, most).mean())]
    for fit in (plain, bent):
        residual, inside, _ = compare_pixels(fit.lenses)
        cost.append(float(np.minimum(residual[inside] ** 2, most).mean()))
    return cost[0] < 0.995 * min(cost[1:])


def _find_doubt(lenses: Microimages, lattice: Lattice) -> str | None:
    offset = measure_centroid_offset(lenses, lattice)
    return None if not offset > _CENTROIDS else (
        f"plain centroids of the microimages in the middle lie {offset:.2f} px beside the lattice, which follows their "
        "edges: the light in them is uneven or reaches into the gaps; if the circles lie off the microimages ('lfcal "
        "show'), light the white image evenly"
    )  # fmt: skip


def _summarise_discs(discs: TwoDiscs, lenses: Microimages) -> WhiteFit:
    lattice, errors, doubt = discs.lens_lattice(), discs.errors(), discs.doubt
    error = float(np.sqrt((errors.of_centres(lattice) ** 2).mean()))
    if error > 0.03 and doubt is None:
        doubt = (
            f"microimages are the overlap of two discs with soft edges ({discs.blur[0]:.2f} px): their "
            f"centres are known to {error:.2f} px only; close the aperture of the main lens for a white image without "
            "vignetting"
        )
    doubt = doubt or _find_doubt(lenses, lattice)
    distance = np.hypot(*discs.offsets.T)
    near = distance[distance < 5 * np.median(distance)]
    residuals = Residuals(discs.indices.astype(np.int32), discs.offsets.astype(np.float32))
    return WhiteFit(
        lattice, discs.cut, doubt, float(np.sqrt((near**2).mean())), errors, len(near), discs.half_difference(),
        residuals,
    )  # fmt: skip
