"""Tuned values of the search for lens types, set by hand on simulated scenes, white images and Raytrix captures."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "DEFAULT",
    "DisparitySettings",
    "FocusSettings",
    "LensTypeSettings",
    "PatternSettings",
    "SampleSettings",
    "TypeCheckSettings",
]


@dataclass(frozen=True)
class SampleSettings:
    """Tuned values of `lens_sample`; zones are shares of the usable radius."""

    blocks: int = 48  # of 144 lenses: patterns of a tenth of the scatter stand out by six standard errors
    full_block: float = 0.25  # least share of its lenses on the flat where there are blocks enough
    sharpness_radius: float = 0.7  # circle in which fine contrast is measured
    core: tuple[float, float] = (0.0, 0.5)
    before_rim: tuple[float, float] = (0.75, 0.95)
    beyond_rim: tuple[float, float] = (1.03, 1.12)
    middle: tuple[float, float] = (0.5, 0.75)  # with `edge`, for a rim whose outer side cannot be used
    edge: tuple[float, float] = (0.8, 0.97)
    lag: float = 1 / 14  # [usable radius] between compared pixels: the finest detail of a microlens
    row_step: float = 1 / 14  # [usable radius]
    dark_lens: float = 0.03  # share of the median light; darker lenses show noise
    quantum: float = 1 / 256  # smallest contrast of an 8-bit picture of mean 1


@dataclass(frozen=True)
class DisparitySettings:
    """Tuned values of `coarse_disparity`."""

    max_ratio: float = 0.6  # of s / D; beyond it neighbours have too little in common
    ratios: int = 25
    disc: float = 0.88  # [usable radius] compared
    sample_step: float = 0.25  # [disc radius]
    min_correlation: float = 0.5
    min_margin: float = 0.04  # over the next best correlation that is not adjacent
    noise_variance: float = 1e-5


@dataclass(frozen=True)
class PatternSettings:
    """Tuned values of `classify`; pairs are for most patterns, and where lattice and pixels beat."""

    above_others: float = 3.0  # times the power of the strongest other pattern: detail of scenes is not noise
    above_noise: float = 12.0  # times the mean power of noise, which reaches it by exp(-12)
    min_contrast: tuple[float, float] = (0.04, 0.07)  # difference between types that matters
    min_outer_light: tuple[float, float] = (0.012, 0.07)
    min_inner_loss: float = 0.015
    min_level: float = 0.004
    min_spread: float = 0.02  # of s / D from which on a scene has depth
    fewest_lenses: int = 100  # with all neighbours on the flat
    scene_repeats: float = 0.3  # share of its power that a mosaic may have in the gradients of the scene
    min_cosine: float = 0.7  # between the patterns of two halves of the sample
    stripes: int = 16  # parts of the sample that alternate between the halves
    beat_cycles: float = 1.2  # periods by which lattice and pixels may get out of step over the flat
    beat_frequency: float = 0.08  # and per lens
    min_radius: float = 5.0  # [px] smaller microimages hold too few pixels to tell sharp from soft
    patterns: int = 64  # others that a mosaic is compared with
    fewest_patterns: int = 24
    pattern_distance: float = 0.05  # [periods per lens] from the mosaics


@dataclass(frozen=True)
class FocusSettings:
    """Tuned values of `focus_order`."""

    clear: float = 4.0  # [standard errors] between neighbours in the order: wrong once in 10,000
    clear_with_foci: float = 3.5  # where three foci confirm the order, which happens by chance in one of six cases
    near: float = 0.12  # [s / D] about equal sharpness in which differences are straight lines
    turns: int = 5
    max_error: float = 0.03  # [s / D] standard error of equal sharpness
    min_spread: float = PatternSettings.min_spread  # of s / D
    fewest_lenses: int = 40  # of a type
    flattened: float = 0.95  # light beyond rims over that before them, from which on they are those of a white image
    min_light: float = 0.015  # difference of light at the rims that is not due to how pixels fall on them
    min_loss: float = 0.1  # light lost before a soft edge over that beyond it; 0.3 to 1 of real rims


@dataclass(frozen=True)
class TypeCheckSettings:
    """Tuned values of `type_check`; significances are those that no right camera of 24 simulated ones had."""

    certain_pattern: float = 0.9  # confidence of a pattern that refutes another
    rim_ratio: float = 20.0  # twice the logarithm of the likelihood ratio of another order of the rims: at most 13
    rim_light: float = 0.015  # light before the rims by which a harder type may have less
    sharpness_significance: float = 5.0  # [standard errors] of a middle type that is the least sharp


@dataclass(frozen=True)
class LensTypeSettings:
    """Tuned values of all stages."""

    sample: SampleSettings = SampleSettings()
    disparity: DisparitySettings = DisparitySettings()
    pattern: PatternSettings = PatternSettings()
    focus: FocusSettings = FocusSettings()
    other_mode: float = 0.2  # share of lenses in the other mode from which on a scene has both: 0.01 to 0.09 are wrong
    check: TypeCheckSettings = TypeCheckSettings()


DEFAULT = LensTypeSettings()
