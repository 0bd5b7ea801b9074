"""Tuned values of the detail room."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "AVERAGING", "COMPRESSION", "DEFOCUS", "HALO", "RESTORE", "SMOOTHING", "SOLVE", "SPECTRA", "CompressionSettings",
    "DefocusSettings", "RestoreSettings", "SolveSettings", "SpectraSettings",
]  # fmt: skip

#: Distances of the outer taps of the smoothings, one upon the other, that part a picture into bands [px].
SMOOTHING = (1, 1, 2, 4)
#: Of those over which the power of a band is averaged.
AVERAGING = (1, 1)
#: [px] around a place that its detail depends on.
HALO = sum((*SMOOTHING, *AVERAGING))


@dataclass(frozen=True)
class CompressionSettings:
    """Tuned values of `compression`."""

    places: int = 60  # about which blocks are looked for
    zero: float = 0.75  # [1/255] coefficients up to this are zero: 2.6 times what rounding of pixels makes
    # As many coefficients are not zero beside the blocks of the file as in them: 1.01 to 1.13 on 24 simulated flats and
    # three captures, from 1.29 on these as JPEG of quality 95.
    more_nonzero: float = 1.2


@dataclass(frozen=True)
class SpectraSettings:
    """Tuned values of `spectra`."""

    neighbours: float = 1.25  # [pitch] how far apart the lenses of a pair are at most
    neighbours_of_type: float = 1.8  # [pitch] likewise, where neighbours are of several types
    alike: float = 0.03  # [pitch] patch sizes of a pair that differ by more may show different places
    pairs: int = 36  # whose spectra are averaged, of each type and range of depth
    least_pairs: int = 16  # fewer are left out
    depth_ranges: int = 5  # into which pairs are parted
    one_depth: float = 0.06  # [pitch] spread of patch sizes below which there is one range
    corner: float = 1.1  # windows reach beyond the microimage in their corners, where they weigh little
    least_window: int = 6  # [px] smaller ones hold too few frequencies
    largest_window: int = 20  # [px] larger ones resolve no more of the blur
    lowest_noise: float = 0.2  # [cycles / px] from where noise is looked for
    highest_noise: float = 0.7  # [cycles / px] and to where
    noise_rings: int = 5  # between these, of which the quietest tells
    quiet: float = 0.1  # quantile of the pairs, by how much the two differ, that differ by noise alone
    darkest: float = 0.01  # [white] less light has as much noise


@dataclass(frozen=True)
class DefocusSettings:
    """Tuned values of `defocus`.

    Priors and `model_error` were chosen on 28 planes (`benchmarks.detail`, seeds 600 to 699): `model_error` 0.12 and a
    narrower prior gain 0.1 dB less in the mean there, and lose up to 4 dB on soft scenes, whose blur is overestimated.
    """

    smallest_aperture: float = 0.05  # [pitch] that is tried
    largest_aperture: float = 0.6  # [pitch] likewise
    aperture_steps: int = 24  # number of those that are tried
    farthest_focus: float = 0.7  # [s / D] largest focus that is tried, of either mode
    focus_steps: int = 41  # number of the foci that are tried
    slope_steps: int = 5  # number of slopes that are tried, up to `spreads` from the likely one
    spreads: float = 2.5  # [standard deviations]
    softest: float = 1.2  # [px at |s / D| = 0.3] largest blur of scenes that is tried
    soft_steps: int = 7  # number of those that are tried
    soft_at: float = 0.3  # [s / D] where `softness` holds; it grows with the patch size
    likely_aperture: float = 0.22  # [pitch] cameras with open microlenses have 0.15 to 0.3
    aperture_spread: float = 0.3  # standard deviation of its logarithm among cameras
    likely_focus: float = 0.0  # [s / D] microlenses focused far away
    focus_spread: float = 0.25  # [s / D] standard deviation among cameras
    known_spread: float = 0.07  # [s / D] standard deviation of a focus that calibration has measured
    likely_slope: float = 2.85  # of scenes: edges alone 3, fine texture 2
    slope_spread: float = 0.4  # standard deviation among scenes
    likely_softness: float = 0.4  # [px at |s / D| = 0.3] mean of an exponential distribution
    noise_pairs: int = 30  # of a camera whose blur is known, to tell the noise
    model_error: float = 0.3  # [share of the power] scenes differ by this from a power law
    lowest_frequency: float = 1.6  # [1 / window] from which spectra are compared
    highest_frequency: float = 0.6  # [cycles / px] and to which
    kept_depths: tuple[float, ...] = (0.1, 0.5, 0.9)  # quantiles of the depths at which a camera's blur is told
    one_depth: float = 0.05  # [s / D] range of these below which one is
    same_depth: float = 0.06  # [s / D] from depths at which a camera's blur is told, it is not measured again
    least_error: float = 0.05  # [px] of a disc: of the steps of what is tried
    lower: float = 0.2  # quantile of the disc that is undone: one too small gains less, one too large rings


@dataclass(frozen=True)
class RestoreSettings:
    """Tuned values of `filters` and `restore`; chosen watching 24 simulated and ray-traced flats."""

    slope: float = 3.0  # of the power spectrum of the detail that is expected
    kept: float = 0.15  # share of the blur by pixels of the flat that is left, as a power: what aliases stays soft
    contradiction: float = 1.4  # [px of the flat] width of detail in which lenses differ by half its power
    least_views: float = 2.0  # lenses averaged, below which nothing is restored
    enough_views: float = 4.0  # and above which all is
    levels: int = 16  # patch sizes of either sign for which filters are computed
    least_ratio: float = 0.06  # |s / D| of the first
    largest_ratio: float = 0.8  # and of the last
    weakest: float = 1e-8  # [white^2] power of detail for which there is a filter
    strongest: float = 0.015  # [white^2] likewise
    powers: int = 14  # number of these
    frequencies: int = 8  # along each side of the quarter of the spectrum on which filters are fitted
    per_ratio: float = 240.0  # entries of the table that pixels are looked up in, for each unit of |s / D|
    per_octave: float = 4.0  # and for each octave of power
    ridge: float = 1.5e-3  # [trace] keeps the fit of the filters well-conditioned
    overshoot: float = 0.25  # [range of the values about] by which a pixel may leave it: no halos
    beside_clipped: int = 3  # [px] no overshoot so near to clipped values: lenses blurred more light than these show
    edge: float = 0.04  # [pitch] depths that differ by this are an edge
    beside_edge: int = 2  # [px] no detail is restored so near an edge
    border: float = 0.5  # [pitch] from the border of the picture, where few lenses are averaged; fades in over as much


@dataclass(frozen=True)
class SolveSettings:
    """Tuned values of `solve`; chosen watching s2_sq, s4b_tspc and two simulated slopes."""

    overshoot: float = 0.4  # [range of the values about] by which a pixel may leave it
    contrast: float = 0.012  # [white] of detail below which the solution is not taken
    rounds: int = 2  # more raise noise and the misfit of the model
    smooth: float = 0.8  # share of what is added that is averaged with its neighbours: less noise
    least_fine: float = 0.7  # [px of the picture per px of the flat] below which the solution is not taken
    fine: float = 0.9  # and above which it is
    beside_edge: int = 6  # [px] the solution is not taken so near a depth edge
    levels: int = 32  # depths |s / D| at which pictures are blurred; between them it is interpolated
    kernel: int = 8  # [px] that interpolation, rounding and smoothing reach


COMPRESSION = CompressionSettings()
SPECTRA = SpectraSettings()
DEFOCUS = DefocusSettings()
RESTORE = RestoreSettings()
SOLVE = SolveSettings()
