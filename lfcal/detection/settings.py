"""Tuned values of the detection stages, all set by hand on white images, scenes and patterns that are neither."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "DEFAULT",
    "CaptureSettings",
    "CellTestSettings",
    "CentreSettings",
    "DetectionSettings",
    "DownscaleSettings",
    "FirstLatticeSettings",
    "GapSettings",
    "HarmonicSettings",
    "ParallaxSettings",
    "SpectrumSettings",
]


@dataclass(frozen=True)
class SpectrumSettings:
    """Tuned values of `spectrum`."""

    window: int = 1024  # [px] side of the windows that are transformed
    shortest_period: float = 4.0  # [px] shorter ones leave nothing to see in a microimage
    fewest_periods: float = 4.0  # across a window
    shortest_harmonic: float = 2.2  # [px] finer harmonics are aliases of coarser ones or the colour mosaic
    background: int = 21  # [bins] side of the box over which the background of the spectrum is averaged
    narrow_backgrounds: tuple[int, ...] = (7, 9)  # [bins] boxes that leave only peaks of a bin or two: the lattice
    row_step: int = 4  # every n-th row is enough to estimate the spread of a spectrum
    prominence: float = 4.0  # [standard deviations] of the whitened log power from which on there is a peak
    peaks: int = 40  # strongest ones that are used
    seeds: int = 10  # strongest and lowest peaks each, of which pairs span the candidates
    nodes: int = 12  # lowest nodes checked, a half plane: the first four shells of a hexagonal lattice
    node_distance: float = 1.0  # [bins] up to which a peak is on a node


@dataclass(frozen=True)
class FirstLatticeSettings:
    """Tuned values of `first_lattice` and of the periods in `tile_lattice`."""

    reductions: tuple[int, ...] = (1, 2, 4)  # factors of downscaling at which periods are looked for
    candidates: int = 6  # bases kept of each spectrum
    tries: int = 10  # bases tried in all
    same_basis: float = 0.04  # share of its steps by which a basis must differ from those tried before
    clear_support: float = 0.3  # of a basis by the spectrum, above which longer periods are not looked for
    min_support: float = 0.1  # below which no pattern repeats
    max_change: float = 0.05  # of a basis by its refinement; right ones move by a thousandth
    min_pitch: float = 0.99 * 6.0  # [px] smaller microimages hold too few pixels; 1 % for measurement errors
    halved_pitch: float = 11.0  # [px] microimages of a flat at half size show all that is needed from here on
    tile: float = 8.0  # [pitch] side of a tile: enough lenses for an average, small against a wandering period
    min_tile: float = 2.5  # [pitch] on small flats
    tiles: int = 5  # each way, on small flats, as far as `min_tile` allows
    cell_tiles: int = 60  # tiles that give an average cell
    level_window: float = 2.0  # [pitch] in which brightness and edges are normalised
    level_tolerance: float = 2.0  # factor by which that window may be wrong before it is done again
    coherence: float = 0.05  # least share of the harmonics' energy common to all tiles; compressed flats have 1/8
    dark_tile: float = 0.4  # share of the tone of bright tiles; tiles below it and `idle_tile` are beside the array
    idle_tile: float = 0.1  # share of the squared lattice amplitude; stray light has a sixth of the array's light
    tone_samples: int = 32  # pixels along a tile that give its mean tone
    repeatability: float = 0.8  # least correlation of the average microimages of two halves of the flat
    stated_repeatability: float = 0.4  # the same where the pitch was stated beforehand, or circles confirm it
    same_stated: float = 0.005  # share of its steps by which stated lattices may differ and be one
    as_likely: float = 0.9  # share of the greatest likelihood from which on another lattice is as likely
    circle_agreement: float = 0.2  # share of circles beyond chance that must lie on an uncertain lattice
    circle_pitches: float = 0.15  # logarithm by which pitches differ at which circles are looked for
    certain_repeatability: float = 0.97  # where one feature reaches this, the other may be too faint
    half_difference: float = 0.03  # [pitch] between lattices of two halves: scenes 0.01, detail of a plane 0.05
    doubtful_roundness: float = 0.6  # least of a doubtful average microimage: scenes 0.62, bricks mostly below 0.5
    doubtful_repeatability: float = 0.99  # most of a doubtful one: scenes reach 0.98, bricks 1
    strongest: int = 8  # harmonics by which the period is refined
    padding: int = 4  # zero padding of the tile grid: a quarter of a fringe is enough for the local search


@dataclass(frozen=True)
class CentreSettings:
    """Tuned values of `cell_centre`."""

    other_energy: float = 0.3  # energy not repeated in a smaller cell: lens types leave 0.2, lenses and gaps 0.5
    min_energy: float = 1e-3  # share of all energy in which a period can be found at all
    negative: float = 0.945  # correlation of a checkerboard with its negative: boards 0.98, soft oblong discs 0.93
    same_edges: float = 0.3  # least correlation of its edges with themselves half a cell further
    rings: int = 24  # steps of distance to the centre in which a cell is averaged
    core: float = 0.25  # [pitch] around a centre that is lens for any fill factor
    nearly_as_round: float = 0.5  # share of the best roundness from which on brightness decides
    gap_brightness: float = 0.85  # most of a gap over that of a lens, unless the picture has been flattened


@dataclass(frozen=True)
class GapSettings:
    """Tuned values of `gaps`; contrasts measured on captures, white images and cameras drawn at random."""

    bins: int = 36  # along a cell
    tiles: int = 60  # of the flat that are averaged
    darkest: float = 0.01  # quantile of the mean cell that is the level of the gaps
    middle: float = 0.6  # [inradius of the cell] radius of its middle
    symmetry: float = 0.15  # [shortest step] from the darkest borders within which the centre of symmetry is looked for
    oblique: float = 0.08  # cosine of the angle of a cell from which on it has six neighbours
    cells: tuple[int, ...] = (1, 2, 3)  # steps each way in which borders are told apart
    faint: float = 0.3  # contrast of brightness [standard deviations] below which edges count too
    least_variance: float = 1e-3  # share of all variance that each place has at least
    clear: float = 0.25  # weakest gap from which on it proves a lattice; lattices too fine have up to 0.02
    dark: float = 0.58  # contrast that dark gaps have [standard deviations]: bricks 0.5, arrays 0.6 to 2.4
    most_tone: float = 0.65  # light of dark gaps over that of cells: arrays up to 0.6, bars from 0.7
    content: float = 0.15  # least content of cells over the contrast: weaves 0.13, scenes 0.17
    idle_tile: float = 0.1  # share of the squared lattice amplitude below which a tile is beside the array
    missing: float = 0.04  # weakest gap below which there is none: lattices too fine have up to 0.02, arrays 0.1


@dataclass(frozen=True)
class CellTestSettings:
    """Tuned values of `cell_tests`."""

    off_line_energy: float = 0.04  # least off the strongest line of harmonics: stripes 0, touching oblong lenses 0.05
    lopsided_energy: float = 0.1  # below which rows dominate, as in print
    radial_share: float = 0.8  # least share of a cell that distances to centre and border explain
    radial_share_scene: float = 0.65  # the same where a scene may be left in the average of a thousand lenses
    radial_share_rows: float = 0.93  # the same where rows dominate
    visible_contrast: float = 0.05  # standard deviation over mean of the light, below which only edges are left
    edge_energy: float = 5e-3  # least beyond the first harmonics; discs have 0.05
    shortest_harmonic: float = SpectrumSettings.shortest_harmonic  # [px]
    sharp_pitch: float = 10.0  # [px] below which the sensor's own blur can leave less than `edge_energy`
    nodes: int = 16  # of the piecewise linear functions of a distance
    samples: int = 18  # along a cell, an even number
    lenses: int = 200  # evenly spread, that give an average cell
    fewest_lenses: int = 4
    dark_lens: float = 0.2  # share of the light of a bright lens; darker ones may lie beside the array
    core: float = 0.25  # [nearest step] radius of the middle of a microimage
    unexplained: float = 0.06  # most share that the two distances leave: white images up to 0.05, mostly 0.01
    gap_brightness: float = 0.96  # most light half way to a neighbour over that in the middle: touching lenses 0.86
    half_shift: float = -0.95  # correlation with itself half a cell further: boards -1, blurred lenses -0.92
    alternating: float = 0.1  # energy of two kinds of cells over that of the mean: threads and bricks 0.25 to 0.5
    alternating_share: float = 0.7  # least share of cells with such a difference: noise 0.5, dust few
    alternating_ratio: float = 3.0  # least energy of it over that of the next difference
    standard_errors: float = 2.0  # that a figure must be beyond its limit


@dataclass(frozen=True)
class ParallaxSettings:
    """Tuned values of `parallax_test`."""

    lenses: int = 450  # evenly spread, that are compared
    fewest_lenses: int = 24
    core: float = 0.6  # [half the nearest step] radius of the middle of a microimage
    core_in_radius: float = 0.7  # most of it over the usable radius
    core_samples: int = 9  # across it
    unlit: float = 0.05  # share of the tone of a lens below which a place in the middle of most lenses has no light
    dark_lens: float = 0.45  # share of the tone of a bright lens; stray light beside an array has a sixth of its light
    type_periods: tuple[tuple[int, int], ...] = ((6, 360), (3, 0))  # period of lens types, and lenses it needs
    compared: float = 0.8  # [usable radius] part of a microimage that is compared
    samples: int = 33  # along a line across it
    lines: tuple[float, ...] = (-0.25, 0.0, 0.25)  # [compared radius] parallel lines
    max_ratio: float = 0.7  # of disparity over step; beyond it too little is common
    ratios: int = 29  # disparities that are tried
    neighbour_distance: float = 1.2  # [nearest step] up to which a lens is a neighbour
    tone_spread: float = 0.03  # differences of whole lenses that are made so
    tone_over_texture: float = 1.3  # most spread of whole lenses over what one shows: scenes 0.8
    gap_tone_white: float = 1.1  # most tone of a gap over that of a lens, in a white image
    gap_tone_scene: float = 1.25  # and in a scene, where flattened ones have up to 1.17
    texture_white: float = 0.03  # contrast inside microimages from which on a white image is a scene
    texture_scene: float = 0.012  # and from which on a scene shows something
    texture_over_noise: float = 2.0
    plain_share: float = 0.1  # lenses with least detail, which give the noise
    typical_share: float = 0.5  # the same where a white image must be shown to be none
    gain: float = 1.3  # least factor by which the right disparity reduces differences: scenes 1.7, patterns 1.2
    sure_gain: float = 1.6  # the same whatever the noise
    across: float = 0.75  # [width that is compared] distance of places across a microimage
    unmoved_gain: float = (
        1.4  # least factor by which they differ more than neighbours that are alike unmoved: 1.5 to 12
    )
    # in captures of light-field microscopes and quarters of them, up to 1.3 in pictures behind meshes and sets of tiles


@dataclass(frozen=True)
class HarmonicSettings:
    """Tuned values of the harmonics in `tile_lattice`."""

    shortest_harmonic: float = SpectrumSettings.shortest_harmonic  # [px]
    significance: float = 9.0  # [squared standard errors] of the mean of a harmonic over the tiles
    min_tile: float = 0.3  # share of a whole tile; smaller ones at the edges are left out
    passes: int = 20
    settled: float = 1e-4  # [px] change below which the fit ends
    fewest_tiles: int = 12  # of which halves can be compared


@dataclass(frozen=True)
class CaptureSettings:
    """Tuned values of `capture_kind`."""

    level_window: float = 2.0  # [pitch] in which brightness is normalised
    lenses: int = 600  # evenly spread, that are looked at
    dark_lens: float = 0.1  # share of the light of a bright lens; noise at 26 dB makes up a third of it
    ring: float = 0.25  # [px] width of the rings of a mean microimage
    scatter_inside: float = 0.15  # most scatter inside microimages of a white image, over the depth of the gaps
    scatter_of_lit: float = 0.09  # the same without dark lenses: scenes have 0.11, white images of dots 0.08


@dataclass(frozen=True)
class DownscaleSettings:
    """Tuned values of `downscale`."""

    large: float = 4.8e7  # [px] flats of more are averaged in blocks
    enough: float = 1.6e7  # [px] down to about so many
    min_pitch: float = 9.0  # [px] that must be left
    pieces: float = 6e6  # [px] white images of fewer are as soon calibrated as a whole as in pieces
    half_size: float = 3e6  # [px] flats of fewer are as soon searched at their own size
    small_part: int = 1024  # [px] side of the part in which the pitch is looked for first
    periods: int = 12  # pitches across it that make it enough
    part: int = 2400  # [px] side of the larger parts
    places: tuple[tuple[float, float], ...] = ((0.5, 0.5), (0.2, 0.5), (0.8, 0.5), (0.5, 0.2), (0.5, 0.8))  # of parts


@dataclass(frozen=True)
class DetectionSettings:
    """Tuned values of all stages of detection."""

    spectrum: SpectrumSettings = SpectrumSettings()
    first_lattice: FirstLatticeSettings = FirstLatticeSettings()
    centre: CentreSettings = CentreSettings()
    gaps: GapSettings = GapSettings()
    cell_tests: CellTestSettings = CellTestSettings()
    parallax: ParallaxSettings = ParallaxSettings()
    harmonics: HarmonicSettings = HarmonicSettings()
    capture: CaptureSettings = CaptureSettings()
    downscale: DownscaleSettings = DownscaleSettings()


DEFAULT = DetectionSettings()
