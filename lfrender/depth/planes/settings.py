"""Tuned values of `planes`, one class per stage."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["DETECTION", "PLANE", "DetectionSettings", "PlaneSettings"]


@dataclass(frozen=True)
class PlaneSettings:
    """Tuned values of `plane_fit`."""

    min_textured_share: float = 0.5  # of the lenses, that must clearly carry texture
    min_inliers: float = 0.9  # share of the lenses that must lie on the plane
    min_ratio: float = 0.1  # |s| / D below which shading may imitate a match
    max_ratio: float = 0.7  # |s| / D above which the overlap is too small
    max_bend: float = 0.025  # [px] between the plane and a smooth surface: half of the regularity error allowed
    uncertain: float = 2.0  # standard errors of the smooth surface, allowed in addition to `max_bend`
    slanted_from: float = 25.0  # variance ratio that proves a slant: by chance one plane in 200,000 exceeds it
    min_scatter: float = 0.006  # [px] of lenses about a plane, caused by interpolation
    # Systematic errors, not averaged out by more lenses; measured on 188 planes of random cameras and two ray tracers.
    shared_error: float = 0.0014  # [px] of any plane
    shared_error_growth: float = 0.0003  # [pitch] per (|s| / D)^3, because of the smaller overlap
    shared_part: float = 0.4  # share of the systematic error of single lenses that all lenses have in common
    min_slant: float = 0.0032  # [px] rms of the patch size: smaller slants are systematic errors
    dependent: int = 4  # lens pairs per independent measurement: both directions, two lenses each
    outlier: float = 4.0  # scatters beyond which a lens is an outlier
    stray_errors: float = 4.0  # standard errors from the plane within which a lens may belong to it
    stray_distance: float = 0.1  # [px] from the plane within which a lens may belong to it
    stray_neighbours: int = 3  # strays beside each other on the same side that are another surface; fewer are noise
    rounds: int = 8  # of the robust fit, at most
    settled: float = 1e-4  # [px] a round that changes no residual by more is the last
    nearly: float = 0.06  # [pitch] from the plane, for patch sizes searched to whole pixels
    nearly_share: float = 0.85  # of the lenses within that; planes have 93 % and more, several depths at most 75 %
    test_lenses: int = 300  # lenses that are tested first, with `test_uncertain` instead of `uncertain`
    test_uncertain: float = 5.0  # standard errors; set by hand


@dataclass(frozen=True)
class DetectionSettings:
    """Tuned values of `detection`."""

    min_textured: int = 40  # lenses: fewer hardly show whether their texture is periodic
    sample: int = 60  # lenses that determine a plane that faces the camera
    sample_share: float = 1 / 12  # share of the lenses with texture that is sampled where these are few
    min_sample: int = 30  # lenses sampled at least
    min_measured: int = 20  # fewer measured lenses determine no plane
    search_pitch: float = 11.0  # [px] of the reduced flat that the sample is searched on
    slanted_sample: int = 6  # times as many lenses for a slant: three numbers, two of them extrapolated to the border
    doubtful_slant: float = 6.0  # variance ratio from which more lenses are measured: one level plane in 20 exceeds it
    large_pitch: float = 35.0  # [px] larger microimages carry more information each, so that fewer of them are needed
    facing_share: float = 0.7  # of the lenses of a plane that faces the camera are searched to the same patch size
    facing_spread: float = 0.05  # [pitch] within which patch sizes count as the same
    off_plane: float = 0.15  # [px of the search] from the plane beyond which a lens seems off it
    off_plane_neighbours: int = 2  # such neighbours on the same side make a lens be measured
    better_by: float = 0.15  # [cost] by which a match elsewhere is better where a lens shows another surface
    far: float = 2.0  # [px] from the plane: a better match farther away needs no neighbour to confirm it
    max_misfits: float = 0.05  # share of lenses that match nowhere
    max_doubtful: float = 0.15  # share of lenses that do not match on the plane above which none is searched
    misfit_factor: float = 2.0  # cost of a misfit over the median: noise and small overlaps raise all costs
    max_misfit_cost: float = 0.6  # cost above which any lens is a misfit


PLANE = PlaneSettings()
DETECTION = DetectionSettings()
