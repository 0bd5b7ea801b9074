"""Tuned values of the detail room."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["AVERAGING", "DEFOCUS", "HALO", "RESTORE", "SMOOTHING", "DefocusSettings", "RestoreSettings"]

#: Three-tap smoothings, one upon the other, that part a picture into bands: distance of the outer taps [px], weight.
SMOOTHING = ((1, 0.15), (1, 0.255), (2, 0.18), (3, 0.25))
#: The same over which the power of a band is averaged.
AVERAGING = ((1, 0.25), (2, 0.25), (3, 0.25))
#: [px] around a place that its detail depends on.
HALO = sum(step for step, _ in (*SMOOTHING, *AVERAGING))


@dataclass(frozen=True)
class DefocusSettings:
    """Tuned values of `defocus`."""

    window: float = 1.44  # [trusted radius] side of the square windows of which spectra are taken
    least_window: int = 8  # [px] smaller ones hold too few frequencies
    largest_window: int = 32  # [px] larger ones resolve no more of the blur
    lenses: int = 48  # whose spectra are averaged, of each type and range of depth
    least_lenses: int = 8  # fewer are left out
    depth_ranges: int = 5  # into which the lenses are parted
    one_depth: float = 0.06  # [pitch] spread of patch sizes below which there is one range
    apertures: tuple[float, float, int] = (0.05, 0.6, 32)  # [pitch] first, last and number of the apertures tried
    farthest_focus: float = 0.7  # [s / D] largest focus that is tried, of either mode
    focus_steps: int = 71  # number of the foci that are tried
    slopes: tuple[float, float, int] = (1.8, 3.8, 21)  # of the power spectra of scenes that are tried
    likely_aperture: float = 0.22  # [pitch] cameras with open microlenses have 0.15 to 0.3
    aperture_spread: float = 0.3  # standard deviation of its logarithm among cameras
    likely_focus: float = 0.0  # [s / D] microlenses focused far away
    focus_spread: float = 0.2  # [s / D] standard deviation among cameras
    known_spread: float = 0.07  # [s / D] standard deviation of a focus that calibration has measured
    likely_slope: float = 2.7  # of scenes: edges alone 3, fine texture 2
    slope_spread: float = 0.3  # standard deviation among scenes
    noise_share: float = 0.95  # of the least power at the highest frequencies
    own_share: float = 0.8  # of the least blur of several types, which is the scene's: one type is near its focus
    model_error: float = 0.2  # [log of power] scenes differ by this from a power law


@dataclass(frozen=True)
class RestoreSettings:
    """Tuned values of `restore`; chosen watching s2_sq, s3_r5, s4b_tspc, s5b_tspc and six simulated scenes."""

    slope: float = 3.0  # of the power spectrum of the detail that is expected
    mismatch: float = 0.005  # share of the power in which lenses differ at any frequency
    jitter: float = 0.15  # [px of the flat] by which lenses are out of register: finer detail is not there
    levels: int = 12  # patch sizes of either sign for which filters are computed
    least_ratio: float = 0.06  # |s / D| of the first
    largest_ratio: float = 0.8  # and of the last
    powers: tuple[float, float, float] = (-8.0, -2.0, 0.3)  # first, last and step of log10 of the detail's power
    frequencies: int = 14  # along each side of the quarter of the spectrum on which filters are fitted
    fine_levels: int = 8  # steps between two patch sizes in the table that pixels are looked up in
    fine_powers: int = 3  # and between two powers
    ridge: float = 1e-4  # [trace] keeps the fit of the filters well-conditioned
    largest_gain: float = 4.0  # factor of a band beyond its own
    contrast: float = 0.012  # [white] of detail below which nothing is sharpened: seams, rounding, compression
    noise_guard: float = 3.0  # [power of the noise] likewise
    extra: float = 0.5  # [power predicted] by which a fine band may exceed the coarser ones
    edge: float = 0.04  # [pitch] depths that differ by this are an edge
    beside_edge: int = 2  # [px] no detail is restored so near an edge
    border: float = 0.5  # [pitch] from the border of the picture, where few lenses are averaged; fades in over as much


DEFOCUS = DefocusSettings()
RESTORE = RestoreSettings()
