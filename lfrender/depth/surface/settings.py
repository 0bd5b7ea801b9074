"""Tuned values of the surface stages."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["SURFACE", "SurfaceSettings"]


@dataclass(frozen=True)
class SurfaceSettings:
    """Tuned values of all modules of `surface`."""

    # Second depths of lenses
    pitch: float = 50.0  # [px] they are looked for at about this pitch: a rod of a tenth of it is five pixels wide
    matched_whole: float = 0.8  # correlation above which a lens is explained by its first depth
    # A pixel is unexplained if it differs by more than the variance of its window, four times that of the noise, and
    share_of_lens: float = 0.2  # this share of the variance of its lens
    half_trust: float = 0.015  # share of a microimage shown by a neighbour at which its match counts half
    least_gain: float = 0.1  # in mismatch of a second depth over the first
    # Depth of scene points
    voting_reach: float = 1.45  # [pitch] lenses within it vote for the depth of a point; set by hand
    jump: float = 0.35  # price of a depth edge in units of the mismatch, between grid values and between lenses
    occluded_cost: float = 2.0  # a hypothesis pays this times what the mismatch of a nearer one stays below `unknown`
    unvoted_cost: float = 0.07  # price of a depth that no lens around votes for, in units of the mismatch
    second_weight: float = 0.1  # vote of a second-best match, which is false in every fourth lens; others have 1
    unknown: float = 0.5  # mismatch of places that too few lenses show, or of noise alone
    occluded_views: float = 2.0  # an occluded hypothesis that mismatches in so many views counts half of the excess


#: Defaults.
SURFACE = SurfaceSettings()
