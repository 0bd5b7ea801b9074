"""Tuned values of sub-pixel refinement."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["REFINEMENT", "RefinementSettings"]


@dataclass(frozen=True)
class RefinementSettings:
    """Tuned values of all modules of `refinement`."""

    # Fits of pairs
    shading_change: float = 0.02  # [share of the light] shading left at the rim by a calibration from one scene
    defocus_pitch: float = 25.0  # [px] of the reduced flat on which lenses of different focus are compared
    likely_blur: float = 2e-3  # [pitch^2] usual half difference of blur variances of two lens types; weak prior
    largest_drift: float = 2.5  # [px] farther from its start a fit has gone over to another optimum
    rim: float = 0.03  # [pitch] left out at the rim, where smoothing and slopes read beyond
    least_rim: float = 0.3  # [px] left out in any case; else planes of 6 px pitch are resolved, 11 % wrong
    # Fits of planes
    rounds: int = 4  # of robust weights; half of them where start values are good
    outlier: float = 3.0  # [standard deviations] scale of the robust loss; twice as far off is another surface
    likely_slant: float = 0.04  # [px per px] slants are rarely steeper
    # Second fits
    far_patch_size: float = 0.4  # [pitch] beyond it neighbours share few pixels, and weak texture biases matches
    bias: float = 0.06  # [pitch] by about so much those matches fall short
    # Smoothing
    least_slant: float = 0.002  # [px per px] no surface is even, and no slant better known
    correlation: float = 0.03  # of the errors of neighbours, which share pixels and pairs; on ray-traced scenes
    common_error: float = 0.0022  # [px] shared by all lenses of a surface; on ray-traced scenes
    steepness: int = 6  # power of the share of inliers by which lenses count farther off
    far_rounds: int = 2  # the second carries values from twice as far


#: Defaults.
REFINEMENT = RefinementSettings()
