"""Tuned values of the preparation of flats."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["MOSAIC", "PREPROCESSING", "STACK", "MosaicSettings", "PreprocessingSettings", "StackSettings"]


@dataclass(frozen=True)
class MosaicSettings:
    """Tuned values of `mosaic`."""

    diagonal_difference: float = 0.03  # [mean light] least between green and others; lattices of whole pixels make less
    row_difference: float = 0.1  # [mean light] least between rows, and between columns, which lattices imitate more
    significance: float = 6.0  # [standard errors over the flat] least of a difference; set by hand
    block: int = 64  # [px] side of the squares that are averaged
    blocks: int = 16  # of them along each side of the flat
    window: float = 1 / 8  # [shorter side] of the square over which phases get the same mean
    smallest_window: int = 65  # [px] enough to hold many lenses


@dataclass(frozen=True)
class PreprocessingSettings:
    """Tuned values of `preprocessing`."""

    noise_floor: float = 0.02  # [mean tone] standard deviation added in normalising, so that noise is not amplified
    clip: float = 3.0  # [local standard deviations] beyond which values are clipped; set by hand
    rows: int = 64  # normalised one after the other at least: the first costs as much as the window is high


@dataclass(frozen=True)
class StackSettings:
    """Tuned values of `stack`."""

    least_contrast: float = 0.05  # [contrast of the best flat] less is a dark, saturated or blank flat; set by hand
    clipped_level: float = 0.995  # [brightest pixel] pixels above it may be clipped
    clipped_share: float = 0.002  # of the flat that must lie above that level to count as clipped
    sample: int = 200_000  # [px] by which exposures are compared
    least_sample: int = 1000  # [px] not clipped in both flats that a comparison needs


MOSAIC = MosaicSettings()
PREPROCESSING = PreprocessingSettings()
STACK = StackSettings()
