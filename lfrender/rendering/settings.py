"""Tuned values of the rendering room."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

__all__ = ["DEFAULT", "SHARPENING", "WEIGHTS", "BlendWeights", "RenderSettings", "SharpenSettings"]


@dataclass(frozen=True)
class RenderSettings:
    """Tuned values of `render`, `refocus`, `viewpoints` and `plan`."""

    reach: float = 1.7  # [pitch] lenses farther from a scene point add little but blur
    fast_reach: float = 1.0  # [pitch] of preset "fast": enough lenses to see every point
    view_reach: float = (
        1.3  # [pitch] of views: farther lenses show the place from other viewpoints; 1.7: 0.2 dB less noise
    )
    refocus_reach: float = 3.0  # [pitch] of `refocus`: the widest blur; as many lenses as the kernel mixes
    agreement: float = 0.2  # [white] difference from the mean colour at which a lens counts a quarter; ghosts exceed it
    refocus_agreement: float = 1e3  # [white] out of focus, colours differ and are mixed all the same
    coarse_ratio: float = 1.4  # patches larger than output pixels by less than this are read once per output pixel
    least_aperture: float = 0.05  # below it, a scene point may lie between what all microimages show
    stack_far: float = 0.02  # quantile of the virtual depth at which a focal stack begins
    stack_near: float = 0.98  # quantile at which it ends
    least_magnification: float = 4 / 3  # least |D / s| that depth analysis resolves
    spacing_lenses: int = 500  # lenses at which the spacing of a distorted lattice is sampled; it changes slowly
    margin: int = 4  # [px] around what a part of a picture reads, for interpolation and sharpening of the flat
    mostly_resolved: float = 0.5  # share of the lenses, above which they are not looked at: it is a scene
    neighbour_reach: float = 1.3  # [pitch] to the neighbours of a lens: not across the diagonal of a square


@dataclass(frozen=True)
class SharpenSettings:
    """Tuned values of `sharpen`."""

    block: int = 64  # [px] side of the blocks that spectra are averaged over; the filter is half as wide
    most_blocks: int = 400  # enough for a spectrum to a few per cent
    most_gain: float = 4.0  # largest gain of a frequency: the shape of the blur is not known well enough for more
    noise_rows: int = 400  # rows of the flat from which the noise is estimated
    blur_share: float = 0.75  # of the measured blur, which has an error of a quarter; too much sharpening costs more
    edge_share: float = 0.06  # [pitch] depths that differ by this within the blur are an edge, and not sharpened
    probe_noise: float = 1e-3  # [white] of the noise image that is rendered: so small that colours agree


class BlendWeights(NamedTuple):
    """Weights of lenses in a blended picture, compiled into the kernels."""

    rim: np.float32 = np.float32(1.02)  # weight is this less the squared distance over the squared reach
    occluded: np.float32 = np.float32(1e-4)  # factor for a pixel that shows another depth: it counts only if all do
    occluded_near: np.float32 = np.float32(0.05)  # [pitch^2] softens the preference for near lenses among those
    one_sample: np.float32 = np.float32(0.05)  # [px] output pixels larger by this than flat pixels are sampled once


DEFAULT = RenderSettings()
SHARPENING = SharpenSettings()
WEIGHTS = BlendWeights()
