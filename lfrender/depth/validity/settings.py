"""Tuned values of validity tests, one frozen dataclass per stage."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CLASSIFY", "ClassifySettings", "PeriodicitySettings", "TexturelessSettings"]


@dataclass(frozen=True)
class ClassifySettings:
    """Tuned values of `classify` and `uncertainty`, and of the stages that use their classes."""

    resolvable: float = 0.75  # [pitch] beyond this patch size neighbouring microimages share too little
    sure: float = 0.5  # confidence and uniqueness of resolved lenses, and the factor of a confidence in doubt
    hardly_shared: float = 0.6  # [pitch] beyond this patch size pairs, or neighbours, must agree
    same_surface: float = 0.06  # [pitch] neighbours at the same depth; half of it for one depth anywhere; set by hand
    occurring_share: float = 0.005  # of the lenses that have a depth, for it to be one that occurs
    proven_confidence: float = 0.95  # of a match that proves faint texture,
    least_correlation: float = 0.12  # and its correlation: of lenses without texture one in a hundred has both
    shading_reach: float = 0.2  # [pitch] shading matches at smaller patch sizes too,
    shading_correlation: float = 0.5  # where a match must correlate this much
    still: float = 0.005  # [pitch] smaller shifts may be errors of the lattice, with which shading stays in place
    still_error: float = 0.002  # [pitch] standard error of a larger shift that proves texture,
    still_sigmas: float = 8.0  # and so many standard errors
    shared: float = 0.25  # correlation below which a lens shares no content with its neighbours
    faint_signal: float = 1 - 1 / 5**2  # signal share of a contrast of five times the noise: less may be file coding
    by_chance: float = 0.4  # correlation that unrelated content reaches at some shift
    alone: int = 1  # neighbours at the depth of a lens, at most, of one that must prove it
    weak_contrast: float = 0.6  # [contrast of the median lens] and has less; right ones, alone, have 0.8 and more
    secondary_peak: float = 0.3  # over the first; less on nine of ten lenses whose texture does not repeat
    both_peaks: float = 1.1  # sum of two peaks over a perfect match: two depths in one lens reach 1
    matched_factor: float = 0.95  # of a standard error if all texture is matched; on ray-traced scenes
    unmatched_factor: float = 2.7  # of it, added in squares, times the share of texture not matched; on the same
    unrelated_error: float = 0.035  # [pitch] standard error of pairs of unrelated content
    clear_signal: float = 0.8  # if the signal is this share of the variance, a correct map has
    clear_correlation: float = 0.55  # a median correlation above this; 0.58 on captures, periodic textures 0.3 to 0.75
    clear_signal_alike: float = 0.5  # the same two if all lenses see nearly the same content;
    clear_correlation_alike: float = 0.8  # planes reach 0.85 there


@dataclass(frozen=True)
class TexturelessSettings:
    """Tuned values of `textureless`."""

    sample: int = 32  # lenses that seem to show only noise and are matched
    enough: int = 3  # of them that match like faint texture: of noise, one in a hundred correlates half as much
    correlation_length: float = 3.0  # [px] over this shift texture as fine as noise
    decay: float = 0.5  # correlates with itself by less than this share of its peak


@dataclass(frozen=True)
class PeriodicitySettings:
    """Tuned values of `periodicity`; lengths on the scene in pitches of a microimage, areas in microimages."""

    resolution: float = 18.0  # [px] of the drawn scene per pitch, at most: periods of a quarter keep their shape
    reach: float = 2.0  # half the side of a part of the scene
    longest_lag: float = 1.2  # depths are a period apart, and beyond this none is left
    spacing: float = 0.5  # of the lenses that are drawn, so that about three overlap
    same_surface: float = 3.0  # factor of patch sizes of one surface, maybe a slanted one
    least_overlap: float = 0.2  # share of what is seen that must overlap itself at a lag
    decayed: float = 0.3  # correlation of what does not repeat, and below which the central peak has ended
    chance: float = 0.8  # mean of two peaks above that, times the root of the area, that proves a period; half: maybe
    least_area: float = 3.0  # of which less cannot show whether it repeats
    little_area: float = 8.0  # lenses that together see less all see nearly the same


#: Defaults, for stages that use the classes.
CLASSIFY = ClassifySettings()
