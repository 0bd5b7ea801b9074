"""Tuned values of the metric calibration."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "ADJUSTMENT",
    "OBSERVATION",
    "START",
    "UNCERTAINTY",
    "AdjustmentSettings",
    "ObservationSettings",
    "StartSettings",
    "UncertaintySettings",
]


@dataclass(frozen=True)
class AdjustmentSettings:
    """Tuned values of `bundle_adjustment` and `model_order`."""

    iterations: int = 60  # Levenberg-Marquardt steps at most; a good start takes 6 to 12
    tolerance: float = 1e-9  # relative decrease of the cost that ends the fit
    first_damping: float = 1e-3  # of the unit diagonal of the normal matrix
    cutoff: float = 6.0  # Tukey's biweight, in standard deviations; keeps 99.6 % of the efficiency on normal errors
    rejection: float = 4.5  # standard deviations from which on an observation is an outlier: 1 normal one in 25,000
    scale_passes: int = 2  # re-estimates of the noise and the weights
    # A group of parameters is fitted if it lowers -2 log likelihood by more than this per parameter, times the log of
    # the number of corners: the Bayesian information criterion.
    bayes_factor: float = 1.0


@dataclass(frozen=True)
class StartSettings:
    """Tuned values of `start`."""

    shortest_focal: float = 0.4  # [widths of the flat], of the grid of focal lengths: 100 degrees wide
    longest_focal: float = 40.0  # [widths of the flat]: 1.4 degrees
    grid: int = 28  # focal lengths tried, 19 % apart; the adjustment converges from twice that
    fewest_lenses: int = 2  # a corner is triangulated from


@dataclass(frozen=True)
class UncertaintySettings:
    """Tuned values of `describe_degeneracies`."""

    weak_length: float = 0.01  # standard error over value from which on a length is called badly known
    correlated: float = 0.98  # correlation from which on two parameters are said to hardly separate


@dataclass(frozen=True)
class ObservationSettings:
    """Tuned values of `observe`, `calibrate_metric` and `locate_board`."""

    edge_blurs: float = 2.0  # blurs that a corner must lie inside the lit part of a microimage
    edge: float = 2.0  # [px] that it must lie inside besides: nearer to the rim its four squares are not all seen
    # [px] by which corners at the rim of microimages lie too far out or in, all of a flat alike: ray-traced boards of
    # others show 0.002 to 0.005.
    rim_bias: float = 0.003
    model_error: float = 0.005  # [px] of the shape of edges, besides the noise of the pixels
    scene_error: float = 0.5  # [px] of corners detected in an all-in-focus picture
    ratio_error: float = 0.02  # of `s / D` there
    first_lenses: int = 8  # that each corner is fitted in at first, until the camera is about known
    fewest_flats: int = 3
    fewest_triangulated: int = 8  # corners of each flat seen in three microimages, to start anew from them
    fewest_corners: int = 10  # of a flat
    alike_angle: float = 4.0  # [degrees] between the normals of boards, below which their poses are alike
    alike_distance: float = 1.05  # farthest over nearest board, below which their distances are alike
    outlier_share: float = 0.4  # of the observations of a flat, from which on it belongs to another camera or board


UNCERTAINTY = UncertaintySettings()
OBSERVATION = ObservationSettings()
ADJUSTMENT = AdjustmentSettings()
START = StartSettings()
