"""Tuned values of the preparation of flats."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["MOSAIC", "PREPROCESSING", "STACK", "MosaicSettings", "PreprocessingSettings", "StackSettings"]


@dataclass(frozen=True)
class MosaicSettings:
    """Tuned values of `mosaic`."""

    block: int = 64  # [px] side of the squares of which spectra are taken, at most
    blocks: int = 12  # of them along each side of the flat
    dark: float = 0.02  # [brightest block] darker ones show no colour
    near: float = 0.052  # [1/px] about the frequencies of a mosaic: colours do not change from pixel to pixel
    beside: tuple[float, float] = (0.09, 0.26)  # [1/px] with which the power there is compared
    quantile: float = 0.75  # of the blocks: a quarter of a scene is coloured
    # Peaks over what is beside them. On 14 captures, 25 white images and 900 lattices of whole pixels without filters
    # sum and difference are unlike by 1.7 where either is above 0.7, and diagonals have 1.0 at most; with filters
    # 9 to 700, by 20 and more; of a twentieth of the usual saturation, or in JPEG files of quality 50, about 1.
    peak: float = 1.0
    unlike: float = 3.0
    diagonal_peak: float = 1.5
    tail: float = 0.02  # share of the places that are the most saturated
    colour_noise: float = 0.01  # difference of the tails on white images
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
