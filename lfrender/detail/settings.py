"""Tuned values of the detail room."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["AVERAGING", "HALO", "RESTORE", "SMOOTHING", "RestoreSettings"]

#: Distances of the outer taps of the smoothings, one upon the other, that part a picture into bands [px].
SMOOTHING = (1, 1, 2, 4)
#: Of those over which the power of a band is averaged.
AVERAGING = (1, 1)
#: [px] around a place that its detail depends on.
HALO = sum((*SMOOTHING, *AVERAGING))


@dataclass(frozen=True)
class RestoreSettings:
    """Tuned values of `filters` and `restore`; chosen watching 24 simulated and ray-traced flats."""

    doubt: float = 0.84  # [standard errors] by which a disc is smaller than the camera file tells: its lower fifth
    slope: float = 3.0  # of the power spectrum of the detail that is expected
    least_views: float = 2.0  # lenses averaged, below which nothing is restored
    enough_views: float = 4.0  # and above which all is
    overshoot: float = 0.25  # [range of the values about] by which a pixel may leave it: no halos
    beside_clipped: int = 3  # [px] no overshoot so near to clipped values: lenses blurred more light than these show
    edge: float = 0.04  # [pitch] depths that differ by this are an edge
    beside_edge: int = 2  # [px] no detail is restored so near an edge


RESTORE = RestoreSettings()
