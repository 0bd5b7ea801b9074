"""Tuned values of the metric calibration."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["ADJUSTMENT", "START", "AdjustmentSettings", "StartSettings"]


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
    fewest_lenses: int = 3  # a corner is triangulated from


ADJUSTMENT = AdjustmentSettings()
START = StartSettings()
