"""Tuned values of sub-pixel refinement, one frozen dataclass per stage."""

from __future__ import annotations

from dataclasses import dataclass

from ..same_surface import TOLERANCE

__all__ = [
    "DefocusSettings", "LensPlaneSettings", "PairFitSettings", "RestartSettings", "SmoothingSettings",
]  # fmt: skip


@dataclass(frozen=True)
class PairFitSettings:
    """Tuned values of `pair_fit`."""

    slope_noise: float = 17 / 144  # energy of smoothed white noise in slopes of one direction; derived from the filter
    difference_noise: float = 0.5  # energy of smoothed white noise in the difference of two microimages; derived
    correlated_signal: float = 4.0  # pixels per independent one at low frequencies, after the B-spline; derived
    correlated_noise: float = 1.62  # the same at frequencies where the slopes are noise; integral over all of them
    least_texture: float = 0.25  # share of the slope energy that counts as texture at least: noise is not known better
    shading_change: float = 0.02  # [share of the light] shading left at the rim by a calibration from one scene
    largest_step: float = 1.0  # [px] per iteration: the start is the best value of a finer grid
    last_step: float = 0.02  # [px] a shorter step ends the iterations: the next one hardly shows
    largest_drift: float = 2.5  # [px] farther from its start a fit has gone over to another optimum
    same_surface: float = TOLERANCE  # [pitch] neighbours on one surface start from their mean
    rim: float = 1.0  # [px] left out at the rim: smoothing and slopes each read a pixel beyond
    rim_share: float = 0.03  # [pitch] left out instead in small microimages
    least_rim: float = 0.3  # [px] left out in any case


@dataclass(frozen=True)
class DefocusSettings:
    """Tuned values of `defocus_difference`."""

    sample: int = 120  # lenses whose pairs are used
    fewest_pairs: int = 12  # of two lens types, to estimate their difference
    dark: float = 0.05  # brightness (white = 1) below which the tone curve counts as at this one
    likely_difference: float = 1e-3  # [pitch^2] usual size of half the difference of blur variances; weak prior
    likely_growth: float = 4e-3  # [pitch] usual size of its growth per s / D; weak prior
    steepest_curve: float = 4.0  # largest tone curve; 1 if light is the square of the stored number
    rounds: int = 4  # blur and tone curve are estimated alternately


@dataclass(frozen=True)
class LensPlaneSettings:
    """Tuned values of `lens_plane`."""

    rounds: int = 4  # of IRLS in the first fit; half of them in the second
    pair_error: float = 0.006  # [px] systematic error of a pair: interpolation, sampling, lattice
    likely_slant: float = 0.05  # [px per px] slants are rarely steeper
    outlier: float = 3.0  # [standard deviations] scale of the robust loss
    common_error: float = 0.9  # factor of errors at s = 0 for what all pairs of a lens share; on ray-traced scenes
    common_error_growth: float = 1.3  # its growth per |s| / D; on ray-traced scenes
    opposite_pairs: float = 2.0  # pairs in opposite directions share their texture error and count as one
    same_surface: float = TOLERANCE  # [pitch] neighbours on one surface share slant and scatter


@dataclass(frozen=True)
class RestartSettings:
    """Tuned values of `restarts`."""

    far_patch_size: float = 0.4  # [pitch] beyond it neighbours share few pixels, and weak texture biases matches
    bias: float = 0.06  # [pitch] by about so much those matches fall short


@dataclass(frozen=True)
class SmoothingSettings:
    """Tuned values of `smoothing`."""

    outlier: float = 3.0  # [standard deviations] scale of the robust weight of a neighbour
    other_surface: float = 6.0  # [standard deviations] beyond it a neighbour has no weight at all
    least_slant: float = 0.002  # [px per px] no surface is even, and no slant better known
    significance: float = 2.5  # least square of a curvature over its variance: flat surfaces have none
    farthest: float = 1.0  # [pitches^2] half the mean square reach of a lens on the scene, at most
    rounds: int = 3  # in which the excess scatter of the neighbours is estimated
    correlation: float = 0.03  # of the errors of neighbours, which share pixels and pairs; on ray-traced scenes
    common_error: float = 0.0019  # [px] shared by all lenses of a surface; on ray-traced scenes
    common_error_growth: float = 0.0005  # [pitches] its growth with (|s| / D)^3: neighbours then share rims only
    far_rounds: int = 2  # the second carries values from twice as far
    inlier_share: float = 0.83  # of the neighbours on a plane, with errors alone
    steepness: int = 8  # power of the inlier share over this one by which lenses count farther off
