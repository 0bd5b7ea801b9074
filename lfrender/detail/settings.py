"""Tuned values of the detail room."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["AVERAGING", "HALO", "NOISE", "RESTORE", "SMOOTHING", "NoiseSettings", "RestoreSettings"]

#: Distances of the outer taps of the smoothings, one upon the other, that part a picture into bands [px].
SMOOTHING = (1, 1, 2, 4)
#: Of those over which the power of a band is averaged.
AVERAGING = (1, 1)
#: [px] around a place that its detail depends on.
HALO = sum((*SMOOTHING, *AVERAGING))


@dataclass(frozen=True)
class NoiseSettings:
    """Tuned values of `noise`. Half the noise moves pictures by 0.01 dB, twice by 0.03 (14 random cameras)."""

    lenses: int = 100  # that are looked at
    half: int = 5  # [px] of the side of the windows in their middles, at most
    quiet: float = 0.1  # quantile of the windows that shows the noise
    darkest: float = 0.01  # [white] less light has as much noise


@dataclass(frozen=True)
class RestoreSettings:
    """Tuned values of `filters` and `restore`; chosen watching 24 simulated and ray-traced flats."""

    doubt: float = 0.84  # [standard errors] by which a disc is smaller than the camera file tells: its lower fifth
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
    per_ratio: float = 60.0  # entries of the table that pixels are looked up in, for each unit of |s / D|
    per_octave: float = 2.0  # and for each octave of power
    ridge: float = 1.5e-3  # [trace] keeps the fit of the filters well-conditioned
    darkest: float = 0.01  # [white] less light has as much noise
    overshoot: float = 0.25  # [range of the values about] by which a pixel may leave it: no halos
    beside_clipped: int = 3  # [px] no overshoot so near to clipped values: lenses blurred more light than these show
    edge: float = 0.04  # [pitch] depths that differ by this are an edge
    beside_edge: int = 2  # [px] no detail is restored so near an edge
    border: float = 0.5  # [pitch] from the border of the picture, where few lenses are averaged; fades in over as much


NOISE = NoiseSettings()
RESTORE = RestoreSettings()
