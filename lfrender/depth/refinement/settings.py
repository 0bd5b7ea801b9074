"""Tuned values of sub-pixel refinement, one frozen dataclass per stage."""

from __future__ import annotations

from dataclasses import dataclass

from ..same_surface import TOLERANCE

__all__ = [
    "LensPlaneSettings", "PairFitSettings", "RestartSettings", "SmoothingSettings",
]  # fmt: skip


@dataclass(frozen=True)
class PairFitSettings:
    """Tuned values of `pair_fit`."""

    shading_change: float = 0.02  # [share of the light] shading left at the rim by a calibration from one scene
    defocus_pitch: float = 25.0  # [px] of the reduced flat on which lenses of different focus are compared
    likely_blur: float = 2e-3  # [pitch^2] usual half difference of blur variances; weak prior
    largest_step: float = 1.0  # [px] per iteration: the start is the best value of a finer grid
    largest_drift: float = 2.5  # [px] farther from its start a fit has gone over to another optimum
    same_surface: float = TOLERANCE  # [pitch] neighbours on one surface start from their mean
    rim: float = 1.0  # [px] left out at the rim: smoothing and slopes each read a pixel beyond
    rim_share: float = 0.03  # [pitch] left out instead in small microimages
    least_rim: float = 0.3  # [px] left out in any case


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
