"""Tuned values of flats and their lens graph."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

__all__ = [
    "BLUR", "COLOUR", "FOCUS", "GRAPH", "GRAY", "KERNEL", "SHADING", "TEXTURE",
    "DemosaicSettings", "FocusSettings", "GrayFlatSettings", "KernelSettings", "LensBlurSettings", "LensGraphSettings",
    "ShadingSettings", "TextureSettings",
]  # fmt: skip


@dataclass(frozen=True)
class LensGraphSettings:
    """Tuned values of `lens_graph`."""

    most_cached: int = 1 << 18  # [lenses] up to which a lattice keeps its neighbour tables
    distant_steps: int = 3  # [lattice steps] between distant rings; estimates so far apart are nearly independent


@dataclass(frozen=True)
class GrayFlatSettings:
    """Tuned values of `gray_flat`."""

    largest_gain: float = 4.0  # more would amplify noise at the rim of a microimage rather than the picture
    uneven: float = 0.01  # [light] variation between lenses from which on one radial profile does not suffice
    trusted_light: float = 0.9  # [light] below it vignetting correction is as uncertain as weak texture is strong
    least_trusted: float = 0.3  # [pitch] a trusted radius is not reduced below it however strong the vignetting
    least_radius: float = 1.5  # [px] nor below this: nothing would be left to compare
    margin: float = 3.0  # [px] that interpolation and smoothing read beyond the trusted radius
    own_share: float = 0.4995  # [distance to the neighbour] within which pixels belong to one lens despite rounding
    own_share_distorted: float = 0.49  # the same if a distortion changes that distance
    most_byte_rows: int = 64  # of bytes whose sum, times three or four channels, fits into 16 bits
    most_cached: int = 1 << 25  # [px] largest flat whose correction image is kept with its camera
    mixed: float = 0.5  # [px of the small image] at the rim that average pixels from beyond it
    most_boxes: float = 0.5  # [share of the flat] covered by lenses, below which they are downsampled one by one
    table_reach: float = 0.75  # [pitch] of the vignetting table
    exposure_rows: int = 16  # from which the exposure of a flat is measured
    headroom: float = 1.1  # least white level over the brightness of nearly all pixels of a dim flat
    bright: float = 0.99  # [quantile] of the pixels, which that brightness is
    octave: int = 4  # steps of the white level within a factor of two
    dim: float = 1.0  # powers of two by which the white level can be lowered, from which on a flat is dim
    rounding: float = 12**-0.5  # [levels] standard deviation of rounding to integers
    table_size: int = 512  # samples of the vignetting table, over the squared distance


@dataclass(frozen=True)
class ShadingSettings:
    """Tuned values of `shading`."""

    largest_contrast: float = 0.02  # [white] of shading; a stronger common pattern is more likely the scene's
    smooth: float = 0.01  # [white] contrast below which lenses have equal weight: a few grey levels of 8 bits
    nearby: float = 4.2  # [pitch] up to which lenses share their shading; nearer than one pitch there are none
    significance: float = 2.0  # [energy of unrelated pictures] by which an average must exceed it to be common


@dataclass(frozen=True)
class TextureSettings:
    """Tuned values of `texture`."""

    fixed_pattern: float = 0.02  # [brightness] contrast that fixed-pattern shading of a microimage may have
    clear: float = 2.5  # [noise] contrast from which on a lens clearly has texture
    faint: float = 0.5  # [noise] contrast from which on it may have texture
    middle: float = 0.36  # [pitch] radius of the middle, where texture must be: the rim does not show its depth
    least_contrast: float = 0.01  # [brightness] of the middle; less is lost in the rounding of 8 bits
    smoothest: float = 0.02  # [share of the lenses] that are no rougher than noise
    grey_level: float = 1 / 255  # [white] least noise: compression, and rounding of 8 bits
    least_radius: float = 6.0  # [px] of microimages whose statistics can be sampled by rows
    sampled_pixels: int = 260  # of a lens, enough to tell whether it has texture
    widest_step: int = 4  # [rows] between sampled rows


@dataclass(frozen=True)
class LensBlurSettings:
    """Tuned values of `lens_blur`."""

    lags: tuple[int, ...] = (1, 2, 3, 4, 6, 8)  # [px] short ones show the blur, long ones the grain of the scene
    least_lags: int = 3  # with fewer, blur and grain cannot be separated
    lenses: int = 240  # that are measured
    depth_ranges: int = 4  # parts of their range of depth that are fitted separately
    widths: tuple[float, float, int] = (1.0, 12.0, 36)  # [px] first, last and number of the blurs that are tried
    grains: tuple[float, float, int] = (0.7, 45.0, 24)  # [px] the same of the grains of the scene


@dataclass(frozen=True)
class FocusSettings:
    """Tuned values of `lens_type_weights`."""

    sharp: float = 0.1  # [s / D] distance from its focus within which a lens type is practically sharp
    steepness: float = 2.0  # power of the fall beyond; more gains on slopes, less at depth edges and against noise


@dataclass(frozen=True)
class DemosaicSettings:
    """Tuned values of `demosaicing`."""

    even: float = 0.01  # [white] smaller differences do not show the direction of an edge: noise and rounding
    similar: float = 0.08  # [white] a guide that differs by more belongs to another surface, more likely than not


class KernelSettings(NamedTuple):
    """Sizes that the kernels of flats are compiled with."""

    bunch: int = 32  # values a vector loop takes at a time
    lens_block: int = 32  # [lenses] that share working memory
    beside: int = 2  # [px] read beyond a microimage


GRAPH = LensGraphSettings()
GRAY = GrayFlatSettings()
SHADING = ShadingSettings()
TEXTURE = TextureSettings()
BLUR = LensBlurSettings()
FOCUS = FocusSettings()
COLOUR = DemosaicSettings()
KERNEL = KernelSettings()
