"""Tuned values of the surface stages, one frozen dataclass per stage."""

from __future__ import annotations

from dataclasses import dataclass

from ..same_surface import TOLERANCE

__all__ = [
    "DensifySettings", "HypothesisSettings", "PhotoconsistencySettings", "SecondLayerSettings", "ThinStructureSettings",
]  # fmt: skip


@dataclass(frozen=True)
class DensifySettings:
    """Tuned values of `densify`."""

    voting_reach: float = 1.45  # [pitch] lenses within it vote for the depth of a point; set by hand
    viewing_reach: float = 2.1  # [pitch] lenses within it may show the point; set by hand
    same_surface: float = TOLERANCE  # [pitch] depths of nearby lenses on one surface are one hypothesis
    least_same_surface: float = 0.75  # [px] the same for small microimages
    jump: float = 0.35  # price of a depth edge between neighbouring grid values, in units of the mismatch
    speck: int = 1  # [grid values] to each side of the window whose median replaces single values


@dataclass(frozen=True)
class HypothesisSettings:
    """Tuned values of `hypotheses`."""

    occluded_cost: float = 2.0  # a hypothesis pays this times what the mismatch of a nearer one stays below `unknown`
    widest: float = 2.0  # [tolerances] votes of one hypothesis extend over no more
    unvoted_cost: float = 0.07  # price of a depth that no lens around votes for, in units of the mismatch
    second_weight: float = 0.1  # vote of a second-best match, which is false in every fourth lens; others have 1


@dataclass(frozen=True)
class PhotoconsistencySettings:
    """Tuned values of `photoconsistency`."""

    best_share: float = 0.5  # of the views, that must agree: an occluder may hide the others
    unknown: float = 0.5  # mismatch of places that too few lenses show, or of noise alone
    occluded_views: float = 2.0  # an occluded hypothesis that mismatches in so many views counts half of the excess


@dataclass(frozen=True)
class SecondLayerSettings:
    """Tuned values of `second_layer`."""

    least_pitch: float = 40.0  # [px] matched at this pitch: a rod of a tenth of it is four pixels wide
    matched_whole: float = 0.8  # correlation above which a lens is explained by its first depth
    share_of_lens: float = 0.2  # a pixel is unexplained if it differs by the variance of its window, this share of the
    noise: float = 6.0  # variance of its lens, and this times the variance of the noise
    least_share: float = 0.012  # of a microimage that is unexplained: less is a blurred edge
    half_trust: float = 0.012  # share of a microimage shown by a neighbour at which its match counts half
    jump_cost: float = 0.3  # semi-global matching: largest price
    largest_cost: float = 0.65  # mismatch of a match, at most; and at all shifts of a lens with nothing unexplained
    least_gain: float = 0.1  # in mismatch over the first depth


@dataclass(frozen=True)
class ThinStructureSettings:
    """Tuned values of `thin_structures`."""

    least_patch_size: float = 0.4  # [pitch] below it neighbours share enough for `second_layer`
    pitch: float = 60.0  # [px] lenses are compared at about this pitch: 3 x 3 pixels fit into a twentieth
    noise: float = 4.0  # variances of a pixel within which two of them are equal
    textured: float = 3.0  # least variance of a 3 x 3 window, in units of those
    confirmed: float = 0.7  # share of the variance of a window by which a neighbour that confirms it may differ
    fewest_views: float = 2.0  # neighbours that confirm a pixel, at least; and half of all
    least_share: float = 0.005  # of a microimage that is confirmed
    fewest_pixels: int = 3  # that are confirmed
    over_chance: float = 2.0  # times as many pixels as at depths beside it: periodic texture is confirmed there too
    beside: float = 0.13  # [pitch] how far those depths are
    longest: int = 60  # [lenses] a structure is followed for so many lenses
    same_hypothesis: float = 0.5  # [tolerances] closer patch sizes are tried once
