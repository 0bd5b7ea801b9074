"""Fit of a white image: lattice and distortion, and the light of its microimages.

The model is fitted to the pixels of many lenses. A few lenses with a radial profile find whether a
disc cuts the microimages and, if so, some more give the lattice of both discs; else as many as are
needed give the final values. Microimages with straight edges have models of their own. A distortion
is kept only if it is significant and moves the centres.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from ..detection.search import Candidate
from ..images.preprocessing import soften_mask
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from ..lattice.robust_fit import LatticeFit
from ..lattice.standard_errors import LatticeErrors, Residuals
from ..microimage.edge import blurred_edge, gaussian_edge
from ..microimage.fit import NEGLIGIBLE, Fit, converge, eliminate_gains, select_orders
from ..runtime.arrays import Floats, Singles
from ..runtime.errors import CalibrationError
from .any_shape import AnyMicroimages
from .find_cut import CENTROIDS, cost_ratio, find_cut, find_doubt
from .lenses import Lenses, cut_out, measure_centroid_offset
from .microimages import Microimages
from .spots import are_spots, fit_spots
from .squares import SquareMicroimages, mean_residual

__all__ = ["fit_lattice_to_white_image", "fit_white", "refine_on_parts"]

# Pixels, and fewest lenses, that a cut and a distortion are looked for with.
_SEARCH = 1e5, 150
# [residual RMS] Microimages farther from the lattice are located by themselves.
_FAR = 2.5
# Pixels of the final fit, which makes centres of white images exact to a few thousandths of a
# pixel.
_PIXELS = 3.2e6
# The same with squares: with these pixels centres are right to a thousandth of a pixel.
_SQUARE_PIXELS = 6e5
# Robust squared residuals with squares over those of a radial profile, below which edges are
# straight: flats with dark gaps between straight edges have 0.17 to 0.23, rounded corners 0.58,
# discs 2.5.
_STRAIGHT = 0.55
# Scatter of single microimages about the lattice of their mean, over that of a radial profile, below
# which the mean is the better model: straight edges have 0.2 to 0.5, discs 0.9 and more.
_NEARER = 0.6


def fit_lattice_to_white_image(picture: Singles | StackedCrops, start: Candidate) -> LatticeFit:
    """Fit a white image (h, w), as made by `sqrt_luminance`, or crops of it.

    The lattice of `start` is kept where the fit runs away.
    """
    found = start.lattice
    if isinstance(picture, np.ndarray):
        if are_spots(picture, found):
            return fit_spots(picture, found)
        picture = soften_mask(picture)
    crops = StackedCrops.of(picture)
    try:
        white = fit_white(crops, found)
    except CalibrationError:
        raise
    except ValueError as error:
        # A distortion that no lattice can have.
        raise CalibrationError(
            "the microimages do not keep to one lattice; give a white image with more of them or "
            "with less noise"
        ) from error
    assert white.residuals is not None
    places = found.points(white.residuals.indices)
    # A distortion that the start does not have is no error of it.
    near = (
        white.lattice if found.distortion is not None else replace(white.lattice, distortion=None)
    )
    distance = near.points(np.rint(near.to_index(places))) - places
    # A fit that has run away.
    if not np.sqrt((distance**2).sum(1).mean()) < 0.2 * found.pitch:
        return LatticeFit(found, white.residual_rms, white.lenses_used, start.half_difference)
    return replace(white, displacement=_displacement(white, places))


def _displacement(white: LatticeFit, places: Floats) -> float:
    """`LatticeFit.displacement` of a fit at `places` (n, 2) [px], centres on the first lattice.

    The first lattice is straight and goes through the middles of the visible microimages; those of
    cut ones lie off the centre by up to half of the cut.
    """
    lattice = white.lattice
    centres = lattice.points(np.rint(lattice.to_index(places)))
    cut = np.zeros(places.shape)
    if white.cut is not None:
        cut = white.cut[:2] + white.cut[2] * lattice.field_place(centres)
    middle = places - places.mean(0)
    base = np.linalg.qr(np.column_stack([np.ones(len(places)), middle / np.abs(middle).max()]))[0]
    distance = base.T @ (centres - places)
    cut = base.T @ cut
    # Of two equal discs, the middle shifts by half of the cut.
    share = np.clip(-(distance * cut).sum() / max(float((cut**2).sum()), 1e-300), 0, 0.5)
    return float(np.sqrt(((distance + share * cut) ** 2).sum() / len(places)))


def fit_white(tones: StackedCrops, lattice: Lattice) -> LatticeFit:
    """Fit a white image.

    CalibrationError if it has fewer than a dozen whole microimages, or if these do not lie on a
    lattice.

    `tones` are parts of a flat as made by `images.preprocessing.sqrt_luminance`; `lattice` is the
    start, right to a fraction of the pitch over the whole flat, whose orders of distortion are
    kept. Used are at most as many lenses, evenly spread, as have `_PIXELS` in all.
    """
    plain = _fit_some(tones, lattice)
    fit = select_orders(plain)
    squares = _fit_squares(fit, plain)
    if squares is not None:
        more = cut_out(tones, squares.lattice, _SQUARE_PIXELS, 0)
        lenses = replace(squares.lenses, **more.given)
        return _summarise(select_orders(converge(squares.lattice, lenses, squares.orders)))
    cut = find_cut(tones, plain, fit)
    if cut is not None:
        return _summarise(cut, cut.lenses.cut, find_doubt(cut))
    if fit.lenses.pixels < _PIXELS:
        whole = Microimages.of(cut_out(tones, fit.lattice, _PIXELS, 0), fit.lenses)
        fit = select_orders(converge(fit.lattice, whole, fit.orders))
    return _summarise(_fit_any_shape(fit))


def _summarise(fit: Fit[Any], cut: Floats | None = None, doubt: str | None = None) -> LatticeFit:
    """The lattice with its standard errors, and the residuals of single microimages."""
    step = fit.step
    number = len(step.names)
    return LatticeFit(
        fit.lattice,
        step.residual_rms,
        int((step.weight > 0).sum()),
        step.half_difference(),
        LatticeErrors(tuple(step.names), step.covariance[:number, :number]),
        Residuals(fit.lenses.indices.astype(np.int32), _locate_lenses(fit).astype(np.float32)),
        cut,
        doubt=doubt or _doubt_of_centroids(fit.lenses),
    )


def _locate_lenses(fit: Fit[Any]) -> Floats:
    """Offsets (n, 2) [px] of single microimages from their centres on the lattice."""
    offsets = fit.step.offsets.copy()
    far = np.flatnonzero(np.hypot(*offsets.T) > _FAR * fit.step.residual_rms)
    if len(far) == 0 or not isinstance(fit.lenses, Microimages):
        return offsets
    # Pixels on their edges are outliers of the common fit: here the weights are so low that each
    # one counts.
    lenses = fit.lenses.select(far)
    start = lenses.centres
    lenses = replace(lenses, ring_weight=1e-9 * lenses.ring_weight)
    for _ in range(5):
        normal, right = eliminate_gains(lenses.sums())
        shift = np.linalg.solve(normal, right[..., None])[..., 0]
        lenses = replace(lenses, centres=lenses.centres + np.clip(shift, -0.5, 0.5))
    offsets[far] = lenses.centres - start
    return offsets


def refine_on_parts(tones: StackedCrops, lattice: Lattice) -> Lattice:
    """The lattice fitted to some lenses of parts of a flat, with a distortion if it is significant.

    `tones` are square roots of the light; the lattice is right to a fraction of the pitch in these
    parts. Raises `CalibrationError` as `fit_white`.
    """
    return select_orders(_fit_some(tones, lattice)).lattice


def _fit_some(tones: StackedCrops, lattice: Lattice) -> Fit[Microimages]:
    """A lattice fitted to some lenses, with the orders of distortion that it has already."""
    lenses = Microimages.of(cut_out(tones, lattice, *_SEARCH))
    bend = lattice.distortion
    orders: tuple[str, ...] = ()
    if bend is not None:
        orders = ("k1",) if bend.general is None else ("general",)
    return converge(lattice, lenses, orders)


def _fit_squares(fit: Fit[Microimages], plain: Fit[Microimages]) -> Fit[SquareMicroimages] | None:
    """The fit with square microimages if these explain the pixels better than a radial profile.

    It begins at `plain`, which has no distortion that is not known: a radial profile on squares can
    have one that the microimages do not have.
    """
    squares = SquareMicroimages.of(fit.lenses, plain.lattice)
    if squares is None:
        return None
    whole = fit.lenses.residuals()
    # Beside their true centres, squares explain less than they will.
    if cost_ratio(squares.residuals(), whole) > 1:
        return None
    converged = []
    # A lens out of focus blurs over a disc, aberrations and pixels over something like a Gaussian.
    for edge in (blurred_edge, gaussian_edge):
        with suppress(CalibrationError, ValueError):
            lenses = replace(squares, edge=edge)
            converged.append(converge(plain.lattice, lenses, plain.orders))
    if not converged:
        return None
    found = min(converged, key=lambda one: mean_residual(one.lenses))
    return found if cost_ratio(found.lenses.residuals(), whole) < _STRAIGHT else None


def _fit_any_shape(fit: Fit[Microimages]) -> Fit[Any]:
    """The fit to the mean microimage if single microimages lie much nearer to its lattice.

    A radial profile cannot follow straight edges: its centres can be farther off than those that
    the fit began at.
    """
    if fit.step.residual_rms < NEGLIGIBLE:
        return fit
    try:
        found = converge(fit.lattice, AnyMicroimages.of(fit.lenses, fit.lattice), fit.orders)
    except (CalibrationError, ValueError):
        return fit
    step = found.step
    nearer = step.residual_rms < _NEARER * fit.step.residual_rms
    # Where all lenses lie alike to the pixels, the mean follows the centres that it is made about.
    if nearer and step.shift_rms < step.uncertainty:
        return found
    return fit


def _doubt_of_centroids(lenses: Lenses) -> str | None:
    offset = measure_centroid_offset(lenses)
    if not offset > CENTROIDS:
        return None
    return (
        f"plain centroids of the microimages in the middle lie {offset:.2f} px beside the lattice, "
        "which follows their edges: the light in them is uneven or reaches into the gaps; if the "
        "circles lie off the microimages ('lfcal show'), light the white image evenly"
    )
