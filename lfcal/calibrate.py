"""Calibrate a focused plenoptic camera from one flat, white or scene, with nothing else given."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .calibration import Calibration
from .errors import CalibrationError, FlatError
from .lattice import Lattice

if TYPE_CHECKING:
    from .fit import LatticeFit
    from .search import FirstLattice

__all__ = ["calibrate"]


def _checked(image: ArrayLike) -> NDArray[Any]:
    """The flat as an array, or FlatError saying what is wrong with it."""
    flat = np.asarray(image)
    if flat.ndim not in (2, 3) or (flat.ndim == 3 and flat.shape[2] != 3):
        raise FlatError(f"image has shape {flat.shape}; give a flat as (height, width) or (height, width, 3)")
    if flat.dtype.kind not in "uif" or 0 in flat.shape:
        raise FlatError(f"image has shape {flat.shape} and type {flat.dtype}; give non-empty real pixel values")
    if flat.dtype.kind == "f" and not np.isfinite(flat.sum(dtype=np.float64)):
        bad = ~np.isfinite(flat).reshape(*flat.shape[:2], -1).all(-1)
        if bad.any():
            y, x = np.argwhere(bad)[0]
            raise FlatError(f"{bad.sum()} pixels are NaN or infinite, first at x={x}, y={y}; fill them in first")
    if min(flat.shape[:2]) < 16:
        raise FlatError(
            f"image of {flat.shape[1]} x {flat.shape[0]} px is too small to be a flat; give the whole sensor"
        )
    return flat


def calibrate(image: ArrayLike, kind: Literal["auto", "white", "scene"] = "auto") -> Calibration:
    """Find the microlens lattice on a flat.

    Parameters
    ----------
    image : (h, w) or (h, w, 3) array_like, any unsigned, signed or float type
        Raw sensor picture: a white image or any scene.
    kind : {"auto", "white", "scene"}
        What the flat shows; `"auto"` decides by how much of the picture the lattice alone explains.

    Returns
    -------
    Calibration

    Raises
    ------
    FlatError
        If the image cannot be a flat: wrong shape, NaN, too small.
    CalibrationError
        If no trustworthy lattice is on it.
    """
    if kind not in ("auto", "white", "scene"):
        raise ValueError(f"kind must be 'auto', 'white' or 'scene', got {kind!r}")
    flat = _checked(image)
    # Compiled code is loaded only when a flat is there to be calibrated.
    from .features import tone
    from .fit import fit_lattice
    from .search import first_lattice
    from .vignetting import measure_vignetting

    picture = tone(flat)
    if float(picture.max()) == 0 or float(picture.std()) < 1e-4:
        raise CalibrationError("the image is one even grey; give a flat with light on it and without saturation")
    start = first_lattice(picture)
    fit = fit_lattice(start.pictures, start.lattice)
    lattice = Lattice(fit.origin, fit.basis, start.lattice.image_size, start.lattice.radius)
    vignetting, radius = measure_vignetting(picture, lattice)
    lattice = Lattice(fit.origin, fit.basis, lattice.image_size, radius)
    source = kind if kind != "auto" else "scene"
    return Calibration(lattice, vignetting, source, fit.residual_rms, fit.lenses_used, _confidence(start, fit))


def _confidence(start: FirstLattice, fit: LatticeFit) -> float:
    """0..1: coherence, roundness and agreement of independent halves, the weakest of which decides."""
    agreement = 1 / (1 + (fit.halves_differ / (0.02 * start.lattice.pitch)) ** 2)
    return float(np.clip(min(start.coherence * 2, start.roundness * 1.5, agreement), 0, 1))
