"""Tuned values of `planes`."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PLANE", "PlaneSettings"]


@dataclass(frozen=True)
class PlaneSettings:
    """Tuned values of the fit of a plane, and of the test for scenes that are one."""

    min_textured_share: float = 0.5  # of the lenses, that must clearly carry texture
    fewest_lenses: int = 40  # that determine a plane, and show whether their texture is periodic
    min_inliers: float = 0.85  # share of lenses on it; planes have 93 % and more, several depths at most 75 %
    significance: float = 4.0  # [standard errors] by which a lens, a bend, or a slant differs from a plane
    bend_errors: float = 2.0  # [standard errors] of a smooth surface through them, allowed beside the tolerance
    tolerance: float = 0.025  # [px] of a bend: half of the regularity error allowed; so much per `significance`, too
    rounds: int = 8  # of the robust fit, at most; set by hand
    settled: float = 0.01  # [tolerance] a round that changes no residual by more is the last; set by hand
    cluster: int = 3  # lenses beside each other off the plane that are another surface; fewer are noise
    # Systematic errors, not averaged out by more lenses; measured on 188 planes of random cameras and two ray tracers.
    shared_error: float = 0.0014  # [px] of any plane
    shared_error_growth: float = 0.0003  # [pitch] per (|s| / D)^3, because of the smaller overlap
    shared_part: float = 0.4  # share of the systematic error of single lenses that all lenses have in common
    sample: int = 60  # lenses of a first, coarse fit, which refuses most scenes, times five


PLANE = PlaneSettings()
