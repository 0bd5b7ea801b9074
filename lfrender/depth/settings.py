"""Tuned values of the modules directly in `depth`, one class per stage."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "CHANGE", "ESTIMATE", "INCREMENTAL", "PIPELINE", "ChangeSettings", "EstimateSettings", "IncrementalSettings",
    "PipelineSettings",
]  # fmt: skip


@dataclass(frozen=True)
class EstimateSettings:
    """Tuned values of `estimate`."""

    second_gap: float = 0.03  # [pitch] from depths of other lenses within which the second-best one is tried
    second_share: float = 0.8  # of the best correlation for that; it is then right in 26 of 27 cases, else in 1 of 5
    default_ratio: float = 0.25  # s / D of a scene without any texture; the sign makes no difference


@dataclass(frozen=True)
class PipelineSettings:
    """Tuned values of `pipeline`."""

    sample: int = 150  # lenses that show which depths occur
    sample_share: float = 1 / 16  # share of the lenses with clear texture that is sampled where these are few
    min_sample: int = 24  # lenses sampled at least
    min_clear: int = 300  # lenses: fewer hardly show whether another depth occurs in a periodic texture
    mostly_clear: float = 0.8  # share of clear lenses below which `more_clear` times as many are sampled and needed
    more_clear: int = 4  # because faint lenses match only at depths that are known to occur
    few_lenses: float = 0.5  # share of the lenses below which the others are left out of all stages
    less_texture: float = 0.9  # share of lenses left by shading correction below which a plane is tried again
    gap: float = 0.05  # [pitch] by which patch sizes of two surfaces differ
    min_gap: float = 1.0  # [px] the same, at least
    unresolved_weight: float = 0.05  # of an unresolved lens beside the confidence of others


@dataclass(frozen=True)
class IncrementalSettings:
    """Tuned values of `incremental`: a lens keeps its depth if neither cost nor minimum have changed."""

    max_cached: int = 1 << 25  # [bytes] of the grey flat that is kept until the next frame
    cost_rise: float = 0.15  # rise of the cost that is allowed
    shift: float = 0.1  # [px of the search] shift of the minimum that is allowed
    shift_errors: float = 4.0  # standard errors of one pair that the shift may have in any case
    shifted_neighbours: int = 2  # neighbours with a shift to the same side that confirm it
    doubtful_share: float = 0.25  # of these limits above which a neighbour of a changed lens is estimated again


@dataclass(frozen=True)
class ChangeSettings:
    """Tuned values of `changed_lenses`."""

    block: int = 4  # [px] side of the blocks whose sums show motion below the noise of a pixel
    small_block: int = 2  # [px] the same for microimages with a radius below `roomy_radius`
    roomy_radius: float = 6.0  # [px] of microimages that hold several blocks
    group_sample: int = 1000  # lenses that set the limits between groups of brightness
    smooth_quantile: float = 0.1  # of the roughness in one frame that shows its noise
    still_quantile: float = 0.25  # of the difference of two frames: most of a scene stands still
    deviations: float = 6.0  # of a sum of squares of noise, allowed: there are hundreds of pixels, dozens of blocks
    rounding: float = 1 / 6  # [levels^2] variance of the difference of two rounded values
    unseen_pixel: float = 2 / 255  # [white = 1] change of a pixel that is invisible, such as video coding makes
    unseen_block: float = 0.5 / 255  # [white = 1] change of the mean of a block that is invisible
    unseen_share: float = 0.007  # of the variance of blocks, ignored as well: motion by a quarter of a pixel makes more


ESTIMATE = EstimateSettings()
PIPELINE = PipelineSettings()
INCREMENTAL = IncrementalSettings()
CHANGE = ChangeSettings()
