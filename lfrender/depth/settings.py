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

    second_share: float = 0.8  # of the best correlation, for a second-best match to be tried; set by hand
    default_ratio: float = 0.25  # s / D of a scene without any texture; the sign makes no difference


@dataclass(frozen=True)
class PipelineSettings:
    """Tuned values of `pipeline`."""

    sample: int = 150  # lenses that show which depths occur; twice as many must have a clear texture
    unresolved_weight: float = 0.05  # of an unresolved lens beside the confidence of others


@dataclass(frozen=True)
class IncrementalSettings:
    """Tuned values of `incremental`: a lens keeps its depth if neither cost nor minimum have changed."""

    max_cached: int = 1 << 25  # [bytes] of the grey flat that is kept until the next frame
    cost_rise: float = 0.15  # rise of the cost that is allowed
    shift: float = 0.1  # [px of the search] shift of the minimum that is allowed
    significance: float = 4.0  # [standard errors] of a shift that is no noise
    cluster: int = 3  # lenses beside each other whose minima have moved; of fewer it is noise
    doubtful_share: float = 0.25  # of these limits above which a neighbour of a changed lens is estimated again


@dataclass(frozen=True)
class ChangeSettings:
    """Tuned values of `changed_lenses`."""

    block: int = 4  # [px] side of the blocks whose sums show motion below the noise of a pixel; half in small lenses
    quiet: float = 0.1  # quantile of the roughness in one frame, or of the difference of two, that shows their noise
    deviations: float = 6.0  # of a sum of squares of noise, allowed: there are hundreds of pixels, dozens of blocks
    unseen_pixel: float = 2 / 255  # [white = 1] change of a pixel that is invisible, such as video coding makes
    unseen_share: float = 0.007  # of the variance of blocks, ignored as well: motion by a quarter of a pixel makes more


ESTIMATE = EstimateSettings()
PIPELINE = PipelineSettings()
INCREMENTAL = IncrementalSettings()
CHANGE = ChangeSettings()
