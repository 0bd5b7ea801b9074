"""Tuned values of `matching`, one class per stage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

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
    all_rows_radius: float = 7.0  # [px] smaller microimages are matched in every row
    half_step_radius: float = 4.0  # [px] smaller microimages are matched at every `half_step`
    half_step: float = 0.5  # [px] because overlaps of few pixels bias the minimum
    second_cost: float = 0.3  # by which the cost of a second minimum may exceed that of the first
    second_if_above: float = 0.2  # cost of the first minimum above which a second one is looked for
    misfit_cost: float = 0.35  # above this cost a lens may match better at a shift that was not tried
    few_lenses: float = 0.2  # share of the lenses below which only their own microimages are cut out
    swapped_confidence: float = 0.6  # share of swapped lenses that are right; measured on simulated scenes
    least_weight: float = 0.02  # overlap weight below which correlations are not normalised any further
    ambiguous: float = 0.5  # uniqueness below which a lens is ambiguous
    periodic_share: float = 0.2  # share of ambiguous lenses above which the texture counts as periodic
    range_cost: float = 0.5  # cost below which a sampled lens adds its depth to the ranges that are searched
    range_margin: float = 0.12  # [pitch] that ranges reach beyond sampled depths: depths between two samples
    range_support: int = 2  # sampled lenses per range: a single one is more likely a false match


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
