"""Limits of the detection stages, all set by hand on white images, scenes and patterns that are neither."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["DETECTION", "DetectionSettings"]


@dataclass(frozen=True)
class DetectionSettings:
    """From where on what repeats on a flat counts as a lattice of microimages."""

    # Of the spectrum.
    prominence: float = 4.0  # [standard deviations] of the whitened log power from which on there is a peak
    clear_support: float = 0.3  # of a basis by the spectrum, above which longer periods are not looked for
    min_support: float = 0.1  # below which no pattern repeats
    # Of the average microimages of tiles and of two halves of a flat.
    repeatability: float = 0.8  # least correlation of the average microimages of two halves of the flat
    half_difference: float = 0.03  # [pitch] between lattices of two halves: scenes 0.01, detail of a plane 0.05
    # Of its cell.
    other_energy: float = 0.3  # energy not repeated in a smaller cell: lens types leave 0.2, lenses and gaps 0.5
    gap_light: float = 0.85  # most of a gap over that of a lens, unless the picture has been flattened
    radial_share: float = 0.8  # least share of a cell that distances to centre and border explain
    radial_share_scene: float = 0.65  # the same where a scene may be left in the average of a thousand lenses
    pattern_repeatability: float = 0.99  # and where two halves are so alike: scenes reach 0.98, bricks 1
    unexplained: float = 0.06  # most share that the two distances leave: white images up to 0.05, mostly 0.01
    half_shift: float = -0.95  # correlation with itself half a cell further: boards -1, blurred lenses -0.92
    edge_energy: float = 5e-3  # least beyond the first harmonics: waves 0, discs 0.05
    # Of gaps; contrasts measured on captures, white images and cameras drawn at random.
    clear_gap: float = 0.25  # weakest gap from which on it proves a lattice; lattices too fine have up to 0.02
    dark_gap: float = 0.58  # contrast that dark gaps have [standard deviations]: bricks 0.5, arrays 0.6 to 2.4
    gap_tone: float = 0.65  # light of dark gaps over that of cells: arrays up to 0.6, bars from 0.7
    content: float = 0.15  # least content of cells over the contrast: weaves 0.13, scenes 0.17
    # Of neighbours that show the same, shifted.
    bright_gap: float = 1.25  # most tone of a gap over that of a lens: sheets with holes 2, flattened scenes 1.17
    texture_white: float = 0.03  # contrast inside microimages from which on a white image is a scene
    texture_scene: float = 0.012  # and from which on a scene shows something
    gain: float = 1.3  # least factor by which the right disparity reduces differences: scenes 1.7, patterns 1.2
    # Least factor by which places across a lens differ more than neighbours that are alike unmoved: 1.5 to 12 in
    # captures of light-field microscopes and quarters of them, up to 1.3 in pictures behind meshes and sets of tiles.
    unmoved_gain: float = 1.4
    # Of white images.
    scatter_inside: float = 0.15  # most scatter inside microimages of a white image, over the depth of the gaps
    scatter_of_lit: float = 0.09  # the same without dark lenses: scenes have 0.11, white images of dots 0.08


DETECTION = DetectionSettings()
