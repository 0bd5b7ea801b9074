"""Tuned values of the data room."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["DEFAULT", "DataSettings"]


@dataclass(frozen=True)
class DataSettings:
    """Tuned values of `surface`, `depth_map`, `viewpoint` and `region`."""

    edge_pixels: float = 0.5  # [px] patch sizes that differ by less always lie on one surface; set by hand
    edge_share: float = 0.03  # [pitch] the same on lenses with a large pitch; set by hand
    full_resolution_share: float = 0.98  # quantile of |patch size| that sets the default scale: outliers are ignored
    slabs: int = 4  # of the range of depths that rays to another viewpoint are followed through; changes no result
    largest_magnification: float = 12.0  # |D / s| is bounded here; no capture has smaller patches than D / 12
    region_margin: float = 4.5  # [pitch] lenses around a region that support it: the reach of the shading correction
    region_step: float = 1.0  # [pitch] parts end at multiples of this, so that the next frame mostly has the same part
    sample_rows: int = 16  # of the fingerprint of a flat, and
    sample_columns: int = 64  # along each
    same_samples: float = 0.02  # [standard deviation of the samples] by which forms of one flat differ: 8 bits 0.01


DEFAULT = DataSettings()
