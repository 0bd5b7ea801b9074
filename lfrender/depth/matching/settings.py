"""Tuned values of `matching`, one class per stage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..same_surface import TOLERANCE

__all__ = ["AMBIGUITY", "COST", "SEARCH", "AmbiguitySettings", "CostSettings", "SearchSettings"]

_f = np.float32


class CostSettings(NamedTuple):
    """Tuned values of `cost_volume` and `local_match`; kernels take them as compile-time constants."""

    # Weight of the squared difference of two means: gains differ a little, but on a smooth slope only means show depth.
    offset_weight: np.float32 = _f(0.5)
    # Overlap [share of the microimage] with half weight; a larger one would bias patch sizes toward zero.
    half_weight_share: float = 0.06
    # Within this |s| / D of zero, remaining shading looks like a match at zero disparity.
    shading_reach: np.float32 = _f(0.08)
    # Contrast [white = 1] at which such a match loses half of its weight.
    shading_contrast: np.float32 = _f(0.03)
    # Overlap [radius^2] below which (a third of a microimage) the pixels at the rim are tested one by one.
    min_overlap: np.float32 = _f(1.0)
    # A Gauss-Newton step of `local_match` is cut off at this length [px]: beyond, only its sign is reliable.
    max_offset: float = 0.75


@dataclass(frozen=True)
class SearchSettings:
    """Tuned values of `matcher`."""

    max_ratio: float = 0.82  # |s| / D searched: a little beyond the largest resolvable one, so that it has two flanks
    # Prices of semi-global matching, set on ray-traced and real flats: at twice the price depth edges suffer.
    slope_price: float = 0.07  # [cost per px of shift] between neighbours
    jump_price: float = 0.8  # [cost] between neighbours, at most
    small_radius: float = 7.0  # [px] smaller microimages are matched in every row
    second_cost: float = 0.3  # by which the cost of a second minimum may exceed that of the first
    misfit_cost: float = 0.4  # above this cost a lens may match better at a shift that was not tried
    swapped_confidence: float = 0.6  # share of swapped lenses that are right; measured on simulated scenes
    periodic_share: float = 0.2  # share of lenses that match as well at another shift, above which texture is periodic
    range_margin: float = 2 * TOLERANCE  # [pitch] that ranges reach beyond sampled depths: depths between two samples


class AmbiguitySettings(NamedTuple):
    """Tuned values of `ambiguity`."""

    # Difference of the mean correlation that makes one shift e times as likely as another, at least.
    temperature: np.float32 = _f(0.05)
    # The same as a share of what the best shift leaves unexplained: poor matches differ less clearly.
    temperature_share: np.float32 = _f(0.5)
    # The correlation falls by this much between two separate peaks.
    dip: np.float32 = _f(0.1)
    # Overlap weight below which a correlation is not used.
    least_weight: np.float32 = _f(0.3)


COST = CostSettings()
SEARCH = SearchSettings()
AMBIGUITY = AmbiguitySettings()
