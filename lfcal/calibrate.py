"""Calibrate a focused plenoptic camera from one flat, white or scene, with nothing else given."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .calibration import Calibration
from .errors import CalibrationError, FlatError
from .lattice import Lattice

if TYPE_CHECKING:
    from .disc_model import CatEye
    from .search import FirstLattice

__all__ = ["calibrate"]

# Two halves of a flat must show average microimages that correlate at least so much.
_REPEATS = 0.8
# Halves that put the lattice further apart than this share of the pitch have not found one.
_SCATTERED = 0.1
# Window, in pitches, in which breaks are levelled: wider than a rim, narrower than what the scene shows in a lens.
_RIM = 0.5
# What the scene shows limits the fit of a scene capture: more pixels than these change nothing.
_SCENE_PIXELS = 2.5e6
# Below this confidence a person should look.
_SURE = 0.7
# Scatter inside the microimages of a white image, as a share of the depth of the gaps.
_EVEN_INSIDE = 0.15
# Relative spread of the tones of an image that shows nothing.
_EVEN = 1e-4


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
    image : (h, w) or (h, w, 3) array_like, any integer or float type
        Raw sensor picture: a white image or any scene.
    kind : {"auto", "white", "scene"}
        What the flat shows; `"auto"` decides by whether microimages are evenly lit inside.

    Returns
    -------
    Calibration
        Its `confidence` is the weakest of several independent tests; below 0.7 there is also a warning.

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
    from .illumination import measure_illumination
    from .search import first_lattice

    picture = tone(flat)
    if float(picture.max()) == 0 or float(picture.std()) < _EVEN * float(picture.mean()):
        raise CalibrationError("the image is one even grey; give a flat with light on it and without saturation")
    start = first_lattice(picture)
    _trust(start.repeatability)
    white = kind == "white" or (kind == "auto" and _evenly_lit(start))
    lattice, residual, lenses, differ, cat_eye = _refined(picture, start, white)
    if not differ < _SCATTERED * lattice.pitch:
        raise CalibrationError(
            f"two halves of the microimages of {lattice.pitch:.1f} px pitch disagree about the lattice; "
            "give a sharper flat or a white image"
        )
    seen = measure_illumination(picture, lattice, white, cat_eye)
    confidence = float(np.clip(min(start.repeatability, 1 - differ / (_SCATTERED * lattice.pitch)), 0, 1))
    warnings = list(seen.warnings)
    if confidence < _SURE:
        warnings.append(
            f"the lattice is uncertain (confidence {confidence:.2f}, halves of the flat differ by {differ:.2f} px); "
            "check the circles on the flat or calibrate on a white image"
        )
    return Calibration(
        replace(lattice, radius=seen.radius),
        seen.vignetting,
        "white" if white else "scene",
        residual,
        lenses,
        confidence,
        tuple(warnings),
        gain_map=seen.gain_map,
        defects=seen.defects,
    )


def _trust(repeatability: float) -> None:
    """CalibrationError where two halves of the flat do not show the same average microimage."""
    if repeatability < _REPEATS:
        from .search import NO_MICROIMAGES

        raise CalibrationError(NO_MICROIMAGES)


def _evenly_lit(start: FirstLattice) -> bool:
    """Whether the insides of microimages vary by little against the depth of the gaps between them."""
    from .fit import radial_profile

    profile = radial_profile(start.brightness, start.lattice)
    radii = np.arange(len(profile.mean)) * profile.step
    inner = radii < 0.5 * start.lattice.radius
    noise = float(np.sqrt(np.average(profile.variance[inner], weights=radii[inner] + profile.step)))
    depth = float(np.ptp(profile.mean))
    return noise < _EVEN_INSIDE * depth


def _refined(
    picture: NDArray[np.float32], start: FirstLattice, white: bool
) -> tuple[Lattice, float, int, float, CatEye | None]:
    """Final lattice, residual of single lenses [px], lenses used, disagreement of halves [px], cutting disc.

    On a white image the brightness of every pixel is what the lattice predicts. On a scene only the breaks at the
    rims are: brightness there also shows where a camera has flattened its pictures with another white image.
    """
    from .features import breaks, level_locally
    from .fit import fit_lattice

    found = start.lattice
    if white:
        from .disc_fit import fit_discs

        discs = fit_discs(picture * picture, found)
        return discs.lattice, discs.residual_rms, discs.lenses_used, discs.halves_differ, discs.cat_eye
    fit = fit_lattice(level_locally(breaks(picture), _RIM * found.pitch), found, pixels=_SCENE_PIXELS)
    if not fit.halves_differ < start.halves_differ:
        # Rims too faint for single lenses: what whole tiles have in common is the better measure.
        return found, fit.residual_rms, fit.lenses_used, start.halves_differ, None
    lattice = Lattice(fit.origin, fit.basis, found.image_size, found.radius)
    return lattice, fit.residual_rms, fit.lenses_used, fit.halves_differ, None
