"""Tuned values of flats."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["SHADING", "TEXTURE", "ShadingSettings", "TextureSettings"]


@dataclass(frozen=True)
class ShadingSettings:
    """Tuned values of `shading`."""

    largest_contrast: float = 0.02  # [white] of shading; a stronger common pattern is more likely the scene's
    smooth: float = 0.01  # [white] contrast below which lenses have equal weight: a few grey levels of 8 bits
    significance: float = 2.0  # [energy of unrelated pictures] by which an average must exceed it to be common


@dataclass(frozen=True)
class TextureSettings:
    """Tuned values of `texture`."""

    fixed_pattern: float = 0.02  # [brightness] contrast that fixed-pattern shading of a microimage may have
    clear: float = 2.5  # [noise] contrast from which on a lens clearly has texture
    faint: float = 0.5  # [noise] contrast from which on it may have texture
    middle: float = 0.36  # [pitch] radius of the middle, where texture must be: the rim does not show its depth
    least_contrast: float = 0.01  # [brightness] of the middle; less is lost in the rounding of 8 bits


SHADING = ShadingSettings()
TEXTURE = TextureSettings()
