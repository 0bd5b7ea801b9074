"""Tuned values of the lattice fit of scenes; set by hand where no source is given."""

from __future__ import annotations

from dataclasses import dataclass

from ..lattice.robust_fit import TUKEY_CUTOFF

__all__ = ["SCENE"]


@dataclass(frozen=True)
class SceneFitSettings:
    """Tuned values of `fit`, `irls`, `radial_distortion` and `template`."""

    fine_pitch: float = 24.0  # [px] of larger microimages fewer pixels are used, as many as of these
    fewest_lenses: int = 12  # for a fit
    sketch_lenses: int = 700  # for the first steps
    most_lenses: int = 20_000  # more do not make the lattice of a scene more accurate
    sketch_passes: int = 4
    passes: int = 10  # at most
    settled: float = 0.2  # [standard errors] shorter steps end the fit
    depth: int = 4  # steps back that Anderson's acceleration combines
    alike: float = 0.05  # relative singular value below which two of them are one
    most_leap: float = 10.0  # longest accelerated step, in single steps
    restarts: int = 1  # times that the lenses that agree best are selected anew after the first time
    runaway: float = 0.05  # relative change of the basis that no true fit makes
    lenses_per_tile: int = 16  # in tiles that make up halves of the flat
    tiles: int = 36  # parts of the flat whose errors are independent of each other
    fewest_in_tile: int = 3  # tiles of fewer lenses could all belong to one half
    fewest_in_half: int = 3  # for a lattice of its own
    good: float = 0.9  # quantile of the information of lenses that is that of a good one
    least_information: float = 0.001  # share of it below which a lens is left out: dark or blank
    doubtful: float = 4.0  # times the variance of the most certain lenses beyond which a lens is left out,
    enough_lenses: int = 2000  # if so many remain
    # Share of the lenses that gives the scale of the residuals. The median would follow a flat most of which is dragged
    # the same way by video compression.
    inliers: float = 0.35
    outlier: float = 3.0  # [standard deviations] lenses farther off have no weight
    fewest_in_part: int = 8  # lenses in a part of the flat from which a search starts
    most_certain: float = 0.02  # quantile of the variance of the lenses below which they count as equally certain
    # Power of the relative variance that the weight falls with. Errors made by the scene grow faster than the variance:
    # a codec moves a whole block along with its content if that outweighs the rims.
    distrust: int = 3
    least_left: float = 0.2  # share of the weight that holds the fit in place at least, for the standard error
    searched: int = 1000  # lenses that select the best of several solutions
    irls_passes: int = 30
    near: float = 1.2  # factor by which the variance changes from pass to pass, nearly always less
    converged: float = 1e-5  # [px] largest change of origin or basis vectors that ends the passes
    nearly_regular: float = 0.003  # relative deviation of a basis that may be regular: arrays are made to 1e-4
    places: int = 12  # parts of a scene with independent errors, whatever the number of lenses
    irregular: float = 6.0  # F value of a significant deviation from regular: one chance in a hundred
    distortion_significance: float = 8.0  # standard errors; scenes without distortion reach 3
    distortion_shift: float = 0.003  # [pitch, RMS] least movement by a distortion; scenes without one reach 0.001
    # Of a distortion about another place than the middle; captures without one reach 12 and 0.003.
    decentred_significance: float = 20.0  # squared size over its covariance, per parameter
    decentred_shift: float = 0.005  # [pitch, RMS] least movement
    bins_per_pixel: float = 3.0  # of the mean microimage
    most_bins: int = 210  # along each lattice vector; more are not worth their memory
    template_lenses: int = 1500  # that are averaged; more hardly lower its noise
    blur: float = 0.5  # [px] standard deviation, about the width of an edge
    pixel_outlier: float = TUKEY_CUTOFF  # [standard deviations] pixels farther off have no weight
    most_contrast: float = 2.0  # times the mean contrast: more does not raise the weight of a lens


SCENE = SceneFitSettings()
