"""Tuned values of `calibrate`, `lattice_search` and `lattice_fit`, set by hand on scenes and white images."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CALIBRATION", "CalibrationSettings"]


@dataclass(frozen=True)
class CalibrationSettings:
    """Tuned values of a calibration as a whole."""

    max_half_difference: float = 0.1  # [pitch] RMS distance of the lattices of two halves, from which on there is none
    unproven_confidence: float = 0.4  # where nothing proves that microimages are what repeats on the flat
    # of scenes whose microimages have the shape of lenses, but show no parallax: 5 of 15 captures, and 4 of 218
    # pictures that are no flats
    shape_confidence: float = 0.85
    # agreement of circles below which parallax proves nothing: 61 scenes have 0.19 and more, 26 crops of captures 0.25;
    # pictures that are no flats, but show parallax by chance, -0.05 to -0.11
    circles: float = 0.1
    lit_share: float = 0.5  # of a scene, by the convex hull of its light: captures have 0.85 and more, one that was a
    # quarter of a pitch beside its lattice 0.17
    glare: float = 0.5  # [mean] standard deviation of the root of the luminance, beyond which a few bright places may
    # outweigh the microimages; files with gamma have up to 0.46, linear ones up to 0.9
    min_roundness: float = 0.55  # of the average microimage, below which they may have done so
    beside_gaps: float = 0.03  # [pitch] RMS distance of a fit to edges from one to dark gaps beyond which it is wrong
    max_distance: float = 0.2  # [pitch] RMS distance from the first lattice from which on a fit has run away
    faint_rims: float = 0.02  # [pitch] scatter of single lenses from which on they cannot be fitted singly
    unlike_gain: float = 0.1  # light of a lens over that of its surroundings, less 1, that dust or a scene makes
    unlike_lenses: float = 0.12  # share of such lenses: 25 dust specks on 1000 large lenses made 0.09, a scene 0.16
    fewest_pixels: float = 20.0  # [px] in a lens from which on its light is measured well enough to compare
    enclosed_dark: float = 0.03  # share of dark lenses between lit ones from which on a flat may be a scene: dust less


CALIBRATION = CalibrationSettings()
