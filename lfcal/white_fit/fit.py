"""Fit of a white image: lattice and distortion, or two discs that cut each other.

The model is fitted to the pixels of many lenses.

All lenses share one lattice and one radial profile; each has its own gain. A distortion is kept
only if it is significant and moves the centres. A few lenses find whether a disc cuts the
microimages and, if so, some more give the lattice of both discs; else as many as are needed give
the final values.

Each Gauss-Newton pass solves for the global parameters, then for the radial profile and the gains
of the lenses, which are hardly correlated with the positions of whole microimages. Weights of
pixels, rings and lenses follow the residuals (IRLS).
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..detection.search import Candidate
from ..images.preprocessing import soften_mask
from ..lattice.distortion import GENERAL_TERMS, Distortion
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from ..lattice.robust_fit import (
    SIGNIFICANT,
    TUKEY_CUTOFF,
    LatticeFit,
    field_rms,
    robust_sigma,
    tukey_weights,
)
from ..lattice.standard_errors import LatticeErrors, Residuals
from ..microimage.edge import blurred_edge, gaussian_edge
from ..runtime.arrays import Floats, Singles
from ..runtime.errors import CalibrationError
from .any_shape import AnyMicroimages
from .fit_discs import fit_two_discs
from .kernel import Sums
from .microimages import (
    Microimages,
    cut_out,
    measure_centroid_offset,
    measure_narrowing,
)
from .spots import are_spots, fit_spots
from .squares import SquareMicroimages, mean_residual
from .two_discs import TwoDiscs

__all__ = ["fit_lattice_to_white_image", "fit_white", "refine_on_parts"]

# Damping of a step by robust weights: for Tukey's biweight and normal residuals the ratio of the
# means of second and first derivative is 0.76 / 0.91, a little more as pixels of several lenses
# have one variance.
_STEP_SCALE = 0.86
# [standard errors of a centre] A fit has converged if its step is shorter.
_CONVERGED = 0.3
# Change of the basis, relative to its start, beyond which the fit has lost the lattice.
_LARGEST_CHANGE = 0.05
# [px] Movements of the centres, and narrowings of microimages, that matter to no picture.
_NEGLIGIBLE = 0.01
# [residual RMS] Microimages farther from the lattice are located by themselves.
_FAR = 2.5
_NO_LATTICE = "the microimages do not keep to one lattice; give a sharper flat or a white image"


@dataclass(frozen=True)
class Step:
    """A Gauss-Newton step of `p` global parameters, with the equations of `n` lenses."""

    names: list[str]  # (p,)
    jacobian: Floats  # (n, 2, p) of the centres with the parameters
    normal: Floats  # (n, 2, 2) of the position of each lens
    right: Floats  # (n, 2)
    change: Floats  # (p,)
    covariance: Floats  # (p, p)
    weight: Floats  # (n,) of the lenses

    @property
    def shift_rms(self) -> float:
        """Movement of the centres, RMS [px]."""
        return field_rms(self.jacobian, self.change)

    @property
    def uncertainty(self) -> float:
        """Standard error of a centre, RMS [px]."""
        spread = np.einsum(
            "nap,pq,naq->n", self.jacobian, self.covariance, self.jacobian, optimize=True
        )
        return float(np.sqrt(max(spread.mean(), 0.0)))

    @property
    def offsets(self) -> Floats:
        """(n, 2) [px] from the centres after the step to those that single microimages show."""
        return (
            np.linalg.solve(self.normal, self.right[..., None])[..., 0] / _STEP_SCALE
            - self.jacobian @ self.change
        )

    @property
    def residual_rms(self) -> float:
        """Distance of single microimages from the lattice, robust RMS [px]."""
        return float(np.sqrt(np.average((self.offsets**2).sum(1), weights=self.weight)))

    def half_difference(self) -> float:
        """RMS distance [px] over the flat between the steps of two halves of the microimages.

        The halves are every other microimage and the rest.
        """
        one, two = (
            _solve(self.jacobian[k::2], self.normal[k::2], self.right[k::2], self.weight[k::2])[0]
            for k in (0, 1)
        )
        return field_rms(self.jacobian, one - two)


@dataclass(frozen=True)
class Fit:
    """A lattice with the fitted distortion `orders`, its microimages, and the last step."""

    lattice: Lattice
    orders: tuple[str, ...]
    lenses: Microimages
    step: Step


def add_distortion(lattice: Lattice, general: bool = False) -> Lattice:
    """The lattice with a distortion of zero strength if it has none, or with a `general` one."""
    bend = lattice.distortion or Distortion.zero(lattice.image_size)
    if general and bend.general is None:
        bend = replace(
            bend,
            general=np.zeros((2, GENERAL_TERMS)),
            middle=(np.array(lattice.image_size) - 1) / 2,
        )
    return replace(lattice, distortion=bend)


def converge(lattice: Lattice, lenses: Microimages, orders: tuple[str, ...]) -> Fit:
    """Gauss-Newton passes until a step is shorter than `_CONVERGED`.

    Raises `CalibrationError` if the microimages show no edges, or keep to no lattice.
    """
    start = lattice.basis
    for _ in range(10):
        sums = lenses.sums()
        names, jacobian = lattice.derivatives(lenses.indices, orders)
        step = _solve_step(names, jacobian, sums)
        lattice = lattice.moved(step.change, names)
        if not np.abs(lattice.basis @ np.linalg.inv(start) - np.eye(2)).max() < _LARGEST_CHANGE:
            raise CalibrationError(_NO_LATTICE)
        lenses = lenses.learn(sums, step.jacobian @ step.change, lattice)
        if step.shift_rms < _CONVERGED * step.uncertainty:
            break
    return Fit(lattice, orders, lenses, step)


def explains_better(fit: Fit, orders: tuple[str, ...]) -> bool:
    """Whether the distortion parameters `orders` would explain a converged fit better.

    The improvement must be significant.

    Its last step is solved again with them: they count if they are significant, and move centres by
    more than `_NEGLIGIBLE` [px, RMS].
    """
    lattice = add_distortion(fit.lattice, "general" in orders)
    names, jacobian = lattice.derivatives(fit.lenses.indices, orders)
    change, covariance, _ = _solve(jacobian, fit.step.normal, fit.step.right, fit.step.weight)
    new = np.array([name in orders and name not in fit.orders for name in names])
    size = change[new] @ np.linalg.pinv(covariance[np.ix_(new, new)]) @ change[new] / new.sum()
    return bool(size > SIGNIFICANT**2 and field_rms(jacobian, change) > _NEGLIGIBLE)


def _solve_step(names: list[str], jacobian: Floats, sums: Sums) -> Step:
    """The next step of the parameters `names`; the gains are eliminated (Schur complement)."""
    normal, right = _position_equations(sums)
    try:
        return Step(names, jacobian, normal, right, *_solve(jacobian, normal, right))
    except np.linalg.LinAlgError as error:
        raise CalibrationError(_NO_LATTICE) from error


def _position_equations(sums: Sums) -> tuple[Floats, Floats]:
    """Normal matrices (n, 2, 2) and right sides (n, 2) of the positions, without the gains."""
    share = sums.normal[:, :2, 2] / np.maximum(sums.normal[:, 2, 2], 1e-30)[:, None]
    normal = np.triu(sums.normal[:, :2, :2]) + np.triu(sums.normal[:, :2, :2], 1).transpose(0, 2, 1)
    normal = normal - share[:, :, None] * sums.normal[:, None, :2, 2]
    # So that those of blank lenses can be inverted.
    normal += 1e-9 * np.trace(normal.sum(0)) / len(normal) * np.eye(2)
    return normal, sums.right[:, :2] - share * sums.right[:, [2]]


def locate_lenses(fit: Fit) -> Floats:
    """Offsets (n, 2) [px] of single microimages from their centres on the lattice."""
    offsets = fit.step.offsets
    far = np.flatnonzero(np.hypot(*offsets.T) > _FAR * fit.step.residual_rms)
    if len(far):
        # Pixels on their edges are outliers of the common fit: here the weights are so low that
        # each one counts.
        lenses = fit.lenses.select(far)
        lenses, start = replace(lenses, ring_weight=1e-9 * lenses.ring_weight), lenses.centres
        for _ in range(5):
            normal, right = _position_equations(lenses.sums())
            shift = np.linalg.solve(normal, right[..., None])[..., 0]
            lenses = replace(lenses, centres=lenses.centres + np.clip(shift, -0.5, 0.5))
        offsets[far] = lenses.centres - start
    return offsets


def _solve(
    jacobian: Floats, normal: Floats, right: Floats, weight: Floats | None = None
) -> tuple[Floats, Floats, Floats]:
    """Change (p,) of the global parameters, its covariance (p, p), weights (n,) of lenses.

    The weights are Tukey's.

    Weights are of the distance of each lens from the common change; those that are nearly known
    need only one pass.
    """
    lenses, _, count = jacobian.shape
    matter = (normal @ jacobian).reshape(-1, count)
    columns = jacobian.reshape(-1, count)
    force = right.reshape(-1)
    alone = np.linalg.solve(normal, right[..., None])[..., 0]
    passes = 1
    if weight is None:
        passes = 3
    weight = np.ones(lenses) if weight is None else weight
    for _ in range(passes):
        weighted = (np.repeat(weight, 2)[:, None] * columns).T
        information = weighted @ matter
        scale = np.sqrt(np.maximum(np.diag(information), 1e-30))
        covariance = np.linalg.pinv(information / np.outer(scale, scale), rcond=1e-12) / np.outer(
            scale, scale
        )
        change = covariance @ (weighted @ force)
        left = alone - (columns @ change).reshape(lenses, 2)
        weight, variance = tukey_weights(((normal @ left[..., None])[..., 0] * left).sum(1))
    return change / _STEP_SCALE, covariance * variance / _STEP_SCALE**2, weight


# [px] Centroids farther from the lattice than this are doubtful.
_CENTROIDS = 0.2
# Pixels, and fewest lenses, that a cut and a distortion are looked for with.
_SEARCH = 1e5, 150
# Pixels, and fewest lenses, that two discs are fitted to.
_DISCS = 8e5, 250
# Pixels of the final fit, which makes centres of white images exact to a few thousandths of a
# pixel.
_PIXELS = 3.2e6
# [px] A disc cuts microimages if it reaches into those in the corners by more than this.
_LEAST_CUT = 0.3
# Robust squared residuals with two discs over those without, up to which the discs are believed.
_MOST_COST = 0.999
# The same with squares, below which edges are straight: flats with dark gaps between straight edges
# have 0.17 to 0.23, rounded corners 0.58, discs 2.5. And how often squares are fitted.
_STRAIGHT = 0.55
_ROUNDS = 3
# Scatter of single microimages about the lattice of their mean, over that of a radial profile, below
# which the mean is the better model: straight edges have 0.2 to 0.5, discs 0.9 and more.
_NEARER = 0.6
# Pixels whose costs are compared: with all, the comparison took half of the time of a calibration.
_COMPARED = 1e5


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
    fit = _select_orders(plain)
    discs = _find_cut(tones, plain, fit)
    if discs is not None:
        found = discs.summarise()
        lenses = plain.lenses
    else:
        if fit.lenses.pixels < _PIXELS:
            lenses = cut_out(tones, fit.lattice, _PIXELS, 0, fit.lenses)
            fit = _select_orders(converge(fit.lattice, lenses, fit.orders))
        fit = _fit_any_shape(_fit_squares(fit, plain))
        found = _summarise(fit)
        lenses = fit.lenses
    return replace(found, doubt=found.doubt or _find_doubt(lenses.at(found.lattice)))


def refine_on_parts(tones: StackedCrops, lattice: Lattice) -> Lattice:
    """The lattice fitted to some lenses of parts of a flat, with a distortion if it is significant.

    `tones` are square roots of the light; the lattice is right to a fraction of the pitch in these
    parts. Raises `CalibrationError` as `fit_white`.
    """
    fit = _fit_some(tones, lattice)
    return _select_orders(fit).lattice


def _fit_some(tones: StackedCrops, lattice: Lattice) -> Fit:
    """A lattice fitted to some lenses, with the orders of distortion that it has already."""
    lenses = cut_out(tones, lattice, *_SEARCH)
    bend = lattice.distortion
    orders: tuple[str, ...] = ()
    if bend is not None:
        orders = ("k1",) if bend.general is None else ("general",)
    return converge(lattice, lenses, orders)


def _try(fit: Fit, orders: tuple[str, ...]) -> Fit:
    """The fit with these `orders` of distortion if they explain it better, else as it is."""
    if set(orders) <= set(fit.orders) or not explains_better(fit, orders):
        return fit
    try:
        return converge(add_distortion(fit.lattice, "general" in orders), fit.lenses, orders)
    except (CalibrationError, ValueError):
        return fit


def _select_orders(fit: Fit) -> Fit:
    """The fit with a radial distortion, and a general one, as far as they are significant."""
    return _try(_try(fit, ("k1",)) if not fit.orders else fit, ("general",))


def _fit_squares(fit: Fit, plain: Fit) -> Fit:
    """The fit with square microimages if these explain the pixels better, else as it is.

    It begins at `plain`, which has no distortion that is not known: a radial profile on squares can
    have one that the microimages do not have.
    """
    squares = SquareMicroimages.of(fit.lenses, plain.lattice)
    if squares is None:
        return fit
    whole = fit.lenses.thin(_COMPARED).residuals()
    # Beside their true centres, squares explain less than they will.
    if _cost_ratio(squares.residuals(), whole) > 1:
        return fit
    converged = []
    # A lens out of focus blurs over a disc, aberrations and pixels over something like a Gaussian.
    for edge in (blurred_edge, gaussian_edge):
        with suppress(CalibrationError, ValueError):
            converged.append(_converge_squares(plain, replace(squares, edge=edge)))
    if not converged:
        return fit
    found = _select_orders(min(converged, key=lambda one: mean_residual(one.lenses)))
    return found if _cost_ratio(found.lenses.residuals(), whole) < _STRAIGHT else fit


def _converge_squares(plain: Fit, squares: SquareMicroimages) -> Fit:
    """The fit with square microimages, from the lattice of a `plain` one."""
    # Blurs of another kind of edge have another meaning.
    found = replace(plain, lenses=squares.learn_shape().learn_shape())
    # Edges of squares turned by 45 degrees are learned slowly.
    for _ in range(_ROUNDS):
        found = converge(found.lattice, found.lenses, plain.orders)
    return found


def _fit_any_shape(fit: Fit) -> Fit:
    """The fit to the mean microimage if single microimages lie much nearer to its lattice.

    A radial profile cannot follow straight edges: its centres can be farther off than those that
    the fit began at.
    """
    if isinstance(fit.lenses, SquareMicroimages) or fit.step.residual_rms < _NEGLIGIBLE:
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


def _cost_ratio(own: Floats, *others: Floats) -> float:
    """Robust squared residual (m,) of one model over the least one of other models."""
    most = (TUKEY_CUTOFF * robust_sigma(own)) ** 2
    cost, *rest = (float(np.minimum(one**2, most).mean()) for one in (own, *others))
    return cost / max(min(rest), 1e-30)


def _find_cut(tones: StackedCrops, plain: Fit, bent: Fit) -> TwoDiscs | None:
    """The discs that cut each other, if the microimages are narrower along the field than across.

    `plain` has no distortion that is not known, `bent` has one if it is significant, of any kind.
    """
    narrowing, error = measure_narrowing(bent.lenses)
    if narrowing < SIGNIFICANT * error:
        return None
    lenses = cut_out(tones, plain.lattice, *_DISCS, plain.lenses)
    discs = fit_two_discs(lenses, plain.lattice)
    # A disc that stays outside the microimages cuts nothing.
    if discs is None or discs.depth < _LEAST_CUT:
        return None
    # Two discs must explain the pixels better than whole microimages of any profile.
    whole = [fit.lenses.residuals() for fit in (plain, bent)]
    if not _cost_ratio(discs.residuals(plain.lenses), *whole) < _MOST_COST:
        return None
    # Where nothing is cut, in the middle, centroids are those of the lenses.
    usual = measure_centroid_offset(plain.lenses)
    beside = measure_centroid_offset(plain.lenses.at(discs.lens_lattice))
    return None if beside > max(_CENTROIDS, usual) else discs


def _find_doubt(lenses: Microimages) -> str | None:
    offset = measure_centroid_offset(lenses)
    if not offset > _CENTROIDS:
        return None
    return (
        f"plain centroids of the microimages in the middle lie {offset:.2f} px beside the lattice, "
        "which follows their edges: the light in them is uneven or reaches into the gaps; if the "
        "circles lie off the microimages ('lfcal show'), light the white image evenly"
    )


def _summarise(fit: Fit) -> LatticeFit:
    """The fit of whole microimages, with the residuals of single ones."""
    step = fit.step
    offsets = locate_lenses(fit)
    return LatticeFit(
        fit.lattice,
        step.residual_rms,
        int((step.weight > 0).sum()),
        step.half_difference(),
        LatticeErrors(tuple(step.names), step.covariance),
        Residuals(fit.lenses.indices.astype(np.int32), offsets.astype(np.float32)),
    )
