"""What a simulated microscope has photographed, and the truth about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from .microscope import Microscope
from .specimen import Specimen

__all__ = ["MicroscopeCapture", "photograph"]

# Largest value of 16 bits.
_TOP = 65535
# Value of the brightest pixel, as a share of the largest value.
_EXPOSURE = 0.8


@dataclass(frozen=True)
class MicroscopeCapture:
    """A flat and a white image of 16 bits, linear, without an offset.

    Parameters
    ----------
    flat, white : (h, w) uint16
    specimen : Specimen
    microscope : Microscope
    calibration : Calibration
        The true lattice, with the light of the white image.

    Examples
    --------
    >>> from data_synth.microscopy import Microscope, Specimen, trace_flat
    >>> capture = trace_flat(Specimen.beads([[0, 0, 2]], 0.5), Microscope(lenses=(9, 9)), samples=2)
    >>> capture.flat.dtype.name
    'uint16'
    """

    flat: NDArray[np.uint16]
    white: NDArray[np.uint16]
    specimen: Specimen
    microscope: Microscope
    calibration: Calibration


def photograph(
    light: NDArray[Any],
    white: NDArray[Any],
    specimen: Specimen,
    microscope: Microscope,
    noise: tuple[float | None, float],
    rng: np.random.Generator,
) -> MicroscopeCapture:
    """The capture of a specimen from the light (h, w) of its flat and of an even field.

    `noise` are the electrons of the brightest pixel, None for no noise, and those of read-out. The
    white image has no noise.
    """
    flat = _expose(light, *noise, rng)
    even = _expose(white, None, 0.0, rng)
    return MicroscopeCapture(flat, even, specimen, microscope, microscope.calibration(white))


def _expose(
    light: NDArray[Any], electrons: float | None, read: float, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """A picture of 16 bits, with photon and read-out noise unless `electrons` is None."""
    shown = light / light.max()
    if electrons is not None:
        counted = rng.poisson(shown * electrons) + read * rng.standard_normal(shown.shape)
        shown = counted / electrons
    return np.rint(np.clip(_EXPOSURE * shown, 0, 1) * _TOP).astype(np.uint16)
