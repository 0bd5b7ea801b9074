"""Tuned values of the fit of a white image, one dataclass a stage; set by hand where no source is given."""

from __future__ import annotations

from dataclasses import dataclass

from ..lattice.robust_fit import TUKEY_CUTOFF

__all__ = [
    "FIT",
    "LARGE",
    "PIXELS",
    "SOLVER",
    "TWO_DISCS",
    "VIGNETTING",
    "FitSettings",
    "LargeSettings",
    "TwoDiscSettings",
]


@dataclass(frozen=True)
class FitSettings:
    """Tuned values of `fit`: how many lenses each of its three steps uses, and when a parameter is kept."""

    fewest_lenses: int = 12  # for a fit
    search_pixels: float = 1e5  # pixels with which a cutting disc is searched for
    search_lenses: int = 150  # and the fewest lenses
    order_pixels: float = 6e5  # pixels with which the parameters of the model are chosen
    order_lenses: int = 400  # and the fewest lenses
    most_order_lenses: int = 8000  # with so many lenses, parameters that matter are significant at any pitch
    part_lenses: int = 800  # lenses with which a lattice is refined on parts of a flat
    first_passes: int = 5  # Gauss-Newton passes before a cutting disc is searched for
    all_pixels: float = 4e6  # flats of so many pixels are used whole
    target_error: float = 3.5e-4  # [px] standard error of centres at which a larger flat has lenses enough
    cut_target_error: float = 2e-3  # [px] the same for cut microimages: the model is off by several times this
    cut_least_pixels: float = 1e5  # fewest pixels for cut microimages
    cut_most_pixels: float = 2e5  # most pixels for cut microimages
    cut_lenses: int = 250  # fewest lenses for cut microimages
    cut_promise: float = 0.03  # [px] standard error of the centres of cut microimages beyond which there is a warning
    least_shift: float = 0.01  # [px, RMS] a further parameter must move centres by this
    promising: float = 0.5  # share of `least_shift` that the first step must predict to try a parameter
    significance: float = 8.0  # standard errors by which a parameter must differ from zero
    least_gain: float = 0.003  # share of the cost that a parameter must save: less may be the model's fault
    correlation_error: float = 0.02  # standard error of the blur correlation of cut edges, whatever pixels imply


@dataclass(frozen=True)
class SolverSettings:
    """Tuned values of `gauss_newton`, of the limits of its steps, and of the robust weights of lenses."""

    passes: int = 15  # at most
    free_passes: int = 5  # passes in which weights follow the residuals; longer, and the fit does not settle
    known_passes: int = 2  # the same where the profile comes from a fit
    # Damping of a step by robust weights: for Tukey's biweight and normal residuals the ratio of the means of second
    # and first derivative is 0.76 / 0.91, a little more with thinned pixels.
    step_scale: float = 0.86
    settled: float = 0.3  # [standard errors] shorter steps end the fit
    remainder: float = 0.1  # [standard errors] so do steps whose geometric series is shorter than this
    steady: float = 0.5  # steps that shrink at least by this factor have such a series
    near: float = 3.0  # [standard errors] a step of whole microimages with a known profile ends the fit: the next
    near_px: float = 0.05  # [px] is a twentieth, if the step is also short against the blur of an edge
    most_dampings: int = 60  # doublings of the damping of a step
    runaway: float = 0.05  # relative change of the basis that no true fit makes
    robust_passes: int = 3  # reweightings of lenses within one step
    brightness_groups: int = 12  # groups of lenses in which noise is measured against brightness
    outlying_scatter: float = 4.0  # times the usual scatter at its brightness: a lens loses weight beyond
    outlying_lens: float = 2.5  # [residual RMS] lenses farther off are located one by one
    single_passes: int = 5  # passes to locate a single lens
    single_step: float = 0.5  # [px] longest of its steps
    single_weight: float = 1e-9  # weight of such a lens, so low that no pixel counts as an outlier
    most_move: float = 0.1  # [disc radius] change of position or radius of the cutting disc in one step
    most_correlation_change: float = 0.2  # change of the blur correlation in one step
    most_correlation: float = 0.98  # edges that run alike are never blurred quite alike
    # [blur * (blur / radius)^3] error of the radius of the cut beside a free profile: on white images of another
    # maker 0.4 px at a blur of a quarter of the radius, 0.06 px at a sixth.
    soft_fault: float = 30.0


@dataclass(frozen=True)
class PixelSettings:
    """Tuned values of `cutouts`, `kernel`, `normal_equations`, `edge_profile` and `shading`."""

    dark: float = 0.03  # share of the light of a bright microimage below which there is none: no lens
    core: float = 0.4  # side of the square that measures the gain, over the diameter of the inscribed circle
    ring_step: float = 0.125  # [px] between rings of the profile: edges of discs are about 1 px wide
    outlier: float = TUKEY_CUTOFF  # [standard deviations] pixels farther off have no weight
    cut_edge: float = 3.0  # [blur] beyond so far from its middle the edge of the cut is all or nothing
    slope_weight: float = 1e-4  # weight of squared steps of the profile over that of its pixels
    bend_weight: float = 0.3  # weight of squared second differences
    ring_damping: float = 0.01  # share of the pixels of a ring below which its level is damped
    even_radius: float = 3.0  # [px] microimages with a larger even inside are thinned there
    even_margin: float = 0.5  # [px] from the even inside to the edge
    # (one pixel in so many, a power of two; shift of each row [px]): the first that leaves `least_even_pixels` is used.
    thinning: tuple[tuple[int, int], ...] = ((64, 14), (16, 6), (4, 2))
    least_even_pixels: int = 100  # in the even inside of a microimage
    steep: float = 0.1  # share of the steepest slope of the profile above which it is an edge
    deepest: float = 3.09  # [blur] beyond, light is within 0.001 of none or all: no depth can be measured
    used_depth: float = 2.3  # [blur] depths used to measure the blur
    fewest_rings: int = 5  # to measure the blur
    beside: int = 2  # rings beside the edge that may still belong to it
    least_tail: float = -0.03  # uniform discs and squares have 0.05, normal blur 0, longer tails less
    most_tail: float = 0.06
    blur_rounds: int = 4  # alternations between line and tail
    gain_lenses: int = 4000  # lenses that the gain over the field is fitted to
    gain_outlier: float = 5.0  # [median residual] of that fit
    slope_inside: float = 0.6  # share of the inscribed radius in which slopes are measured: cuts are rare, edges far
    slope_significance: float = 6.0  # standard errors beyond which slopes are used
    slope_outlier: float = 4.0  # [median residual]
    # Of the way from the inscribed circle of a cell to its corners: no slope of the light is left there. On five
    # arrays of soft discs that overlap, hexagonal and square, centres are off by at most 0.04 px; with 0 by 0.25 px.
    border: float = 1 / 6


@dataclass(frozen=True)
class VignettingSettings:
    """Tuned values of `mechanical_vignetting`."""

    least_gain: float = 0.005  # share of the cost that a cutting disc must save
    least_depth: float = 0.3  # [px] it must reach into microimages
    significance: float = 8.0  # standard errors: costs that differ by its square are different
    settled: float = 1.0  # [standard errors] steps of trial fits may be this long; all lenses follow afterwards
    least_narrowing: float = 0.01  # [px] cos(2 * angle) of the edge; a cut by one pixel has 20 times this
    narrowing_significance: float = 6.0  # standard errors of it
    outlier: float = 6.0  # [standard deviations] of pixels
    # Centroids in the middle: there cut microimages are whole.
    middle: float = 0.25  # of the way to the corners
    middle_lenses: int = 300  # at most
    fewest_lenses: int = 12
    dark: float = 0.05  # quantile of the light in a window that stands for that of the gaps


@dataclass(frozen=True)
class TwoDiscSettings:
    """Tuned values of `two_discs`."""

    lenses: int = 300  # at most, evenly chosen
    first_pixels: int = 10_000  # at most, to begin with
    pixels: int = 40_000  # at most
    passes: int = 25  # of Levenberg-Marquardt, at most
    plain_passes: int = 3  # passes before outliers lose weight
    tries: int = 8  # of a step, with more and more damping
    damping: float = 1e-2
    converged: float = 1e-5  # relative fall of the cost that ends the fit
    start_growth: float = 0.3  # [radius] distance of the two discs in the corners
    start_radii: tuple[float, float] = (1.02, 1.08)  # [radius] of both discs
    start_blur: float = 0.4  # [px] at least
    start_shading: float = 0.02
    start_correlation: float = 0.3
    # Standard deviations by which parameters are expected to differ from where the fit starts.
    radius_spread: float = 0.3  # [radius]
    blur_spread: float = 0.5  # of its logarithm
    blur_difference: float = 0.01  # of the logarithms of both
    blur_unlike: float = 0.1  # difference from which on they are taken to be unlike
    shading_spread: float = 0.3
    gap_spread: float = 0.1
    tail_spread: float = 0.03
    correlation_spread: float = 0.5
    least_radius: float = 0.3  # [radius] bounds of a disc
    most_radius: float = 2.0
    least_blur: float = 0.2  # [px] pixels of finite size blur every edge by this
    most_blur: float = 0.5  # [radius]
    least_tail: float = -0.03  # as of `PixelSettings`
    most_tail: float = 0.06
    most_correlation: float = 0.98
    sure: float = 2.5  # standard errors by which radii or shadings must differ to tell the lens
    radius_fault: float = 0.05  # [blur] error of the difference of radii where the model of the edges is not exact
    shading_fault: float = 0.3  # [(blur / radius)^2] the same of shadings
    least_bend: float = 0.15  # [px] distortion in the corners that a fit starts with
    bend_significance: float = 6.0  # standard errors of it


@dataclass(frozen=True)
class LargeSettings:
    """Tuned values of `large`."""

    first_side: int = 768  # [px] side of the piece in which the lattice is found
    first_periods: int = 10  # pitches that must fit into it
    repeatability: float = 0.8  # correlation of the mean microimages of two halves of a piece
    piece_pitches: float = 14.0  # side of the pieces on which the lattice is extended, in pitches
    piece_side: int = 256  # [px] and at least
    # Distance to the next pieces over that to the last ones: a cubic that moves centres by hardly 0.01 px up to here
    # moves them by 0.16 px there.
    spacing: float = 2.5
    window: float = 2.0  # [pitch] within which pieces are levelled to test that the flat is even
    even_pitches: float = 6.0  # side of the parts for this test, in pitches: whole lenses and their neighbours
    even_parts: float = 25.0  # number of such parts, of short pitches
    fewest_even_parts: float = 9.0  # and of any
    sample_side: int = 768  # [px] side of the parts that stand for a flat too large for memory
    sample_pixels: float = 1.6e7  # pixels of all these parts


FIT = FitSettings()
SOLVER = SolverSettings()
PIXELS = PixelSettings()
VIGNETTING = VignettingSettings()
TWO_DISCS = TwoDiscSettings()
LARGE = LargeSettings()
