"""What a simulated microscope has photographed, and the truth about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from .microscope import Microscope
from .specimen import Specimen

__all__ = ["MicroscopeCapture", "expose"]

_TOP = 65535
# Of the brightest pixel.
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


def expose(
    light: NDArray[Any], electrons: float | None, read: float, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """16 bits of a picture whose brightest pixel has so many electrons, with photon and read-out
    noise; None: without noise."""
    shown = light / light.max()
    if electrons is not None:
        counted = rng.poisson(shown * electrons) + read * rng.standard_normal(shown.shape)
        shown = counted / electrons
    return np.rint(np.clip(_EXPOSURE * shown, 0, 1) * _TOP).astype(np.uint16)
