"""Validation of the flats given to `calibrate`, and whether they are white images or scenes.

Microimages of a white image are evenly lit inside: their scatter is small against the depth of the gaps between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops
from ..runtime.errors import FlatError
from .first_lattice import FirstLattice
from .radial_profile import RadialProfile, measure_radial_profile
from .settings import DEFAULT, CaptureSettings

__all__ = ["check_flats", "choose_white_or_scene", "estimate_white_level", "is_evenly_lit", "measure_overexposure"]


def check_flats(image: ArrayLike | Sequence[ArrayLike]) -> list[NDArray[Any]]:
    """The flats given, one or several, as arrays.

    Raises
    ------
    FlatError
        If one cannot be a flat, or their sizes differ.
    """
    given: Any = image
    several = isinstance(given, (list, tuple)) and len(given) > 0 and np.ndim(given[0]) >= 2
    if not several and np.ndim(given) != 4:
        return [_check_flat(given, "image")]
    if len(given) == 0:
        raise FlatError("no flat is given; give at least one")
    flats = [_check_flat(flat, f"flat {k}") for k, flat in enumerate(given, 1)]
    first = flats[0].shape
    for k, flat in enumerate(flats, 1):
        if flat.shape[:2] != first[:2]:
            raise FlatError(
                f"flat {k} is {flat.shape[1]} x {flat.shape[0]} px, flat 1 is {first[1]} x {first[0]} px; "
                "give flats of one camera"
            )
    return flats


def estimate_white_level(flats: Sequence[NDArray[Any]]) -> float | None:
    """Largest value of the 8, 10, 12 or 14 bits that the sensor has, in 16-bit files; None where that is unknown."""
    if any(flat.dtype.kind not in "ui" or flat.dtype.itemsize == 1 for flat in flats):
        return None
    largest = max(int(flat.max()) for flat in flats)
    return next((float(2**bits - 1) for bits in (8, 10, 12, 14) if largest < 2**bits), None)


def measure_overexposure(flat: NDArray[Any]) -> float:
    """Share of the pixels of a flat at the largest value that its type, or a sensor of fewer bits, can have."""
    if flat.dtype.kind != "u":
        return 0.0
    top = int(flat.max())
    if top != np.iinfo(flat.dtype).max and top not in (1023, 4095, 16383):
        return 0.0
    # One channel after the other: reductions over so few values take several times as long.
    channels = np.moveaxis(flat.reshape(*flat.shape[:2], -1), -1, 0)
    return float(np.logical_or.reduce([channel >= top for channel in channels]).mean())


def _check_flat(image: ArrayLike, name: str) -> NDArray[Any]:
    """The flat as an array, or FlatError."""
    flat = np.asarray(image)
    if flat.ndim not in (2, 3) or (flat.ndim == 3 and flat.shape[2] != 3):
        raise FlatError(f"{name} has shape {flat.shape}; give a flat as (height, width) or (height, width, 3)")
    if flat.dtype.kind not in "uif" or 0 in flat.shape:
        raise FlatError(f"{name} has shape {flat.shape} and type {flat.dtype}; give non-empty real pixel values")
    if flat.dtype.kind == "f" and not np.isfinite(flat.sum(dtype=np.float64)):
        bad = ~np.isfinite(flat).reshape(*flat.shape[:2], -1).all(-1)
        if bad.any():
            y, x = np.argwhere(bad)[0]
            where = f"first at x={x}, y={y}" + ("" if name == "image" else f" of {name}")
            raise FlatError(f"{bad.sum()} pixels are NaN or infinite, {where}; fill them in first")
    # Sums of squares of larger values leave the range of single precision; unsigned ones are never as large.
    limit = 1e30
    if flat.dtype.kind != "u" and max(-float(flat.min()), float(flat.max())) > limit:
        raise FlatError(f"{name} has values up to {np.abs(flat).max():.3g}; scale them to at most {limit:.0e} first")
    if min(flat.shape[:2]) < 16:
        raise FlatError(
            f"{name} of {flat.shape[1]} x {flat.shape[0]} px is too small to be a flat; give the whole sensor"
        )
    return flat


def choose_white_or_scene(
    lights: list[NDArray[np.float32]], start: FirstLattice, kind: str, settings: CaptureSettings = DEFAULT.capture
) -> tuple[bool, list[NDArray[np.float32]]]:
    """Whether to calibrate on white images, and the luminance pictures (h, w) to use: with `kind` "auto" white ones."""
    if kind != "auto":
        return kind == "white", lights
    if len(lights) == 1:
        return _is_evenly_lit_at(start, lights[0], settings), lights
    from ..images.preprocessing import normalise_locally, sqrt_luminance

    window = settings.level_window * start.lattice.pitch
    whites = [
        light
        for light in lights
        if is_evenly_lit(normalise_locally(sqrt_luminance(light), window), light, start.lattice, settings)
    ]
    return (True, whites) if whites else (False, lights)


def _is_evenly_lit_at(start: FirstLattice, light: NDArray[np.float32], settings: CaptureSettings) -> bool:
    """`is_evenly_lit` at the size at which the lattice was found."""
    factor = light.shape[0] // start.brightness.shape[0]
    if factor == 1:
        return is_evenly_lit(start.brightness, light, start.lattice, settings)
    import cv2

    height, width = start.brightness.shape
    small: Any = cv2.resize(light[: factor * height, : factor * width], (width, height), interpolation=cv2.INTER_AREA)
    return is_evenly_lit(start.brightness, small, start.lattice.downscaled(factor), settings)


def is_evenly_lit(
    brightness: NDArray[np.float32] | StackedCrops,
    light: NDArray[np.float32],
    lattice: Lattice,
    settings: CaptureSettings = DEFAULT.capture,
) -> bool:
    """Whether the insides of lit microimages vary by little against the depth of the gaps between them.

    Parameters
    ----------
    brightness : (h, w) float32, or crops
        Locally normalised (`images.preprocessing.normalise_locally`).
    light : (h, w) float32
        Luminance of the flat, or of these crops.
    lattice : Lattice [px]
    """
    return (
        _scatter_inside(measure_radial_profile(brightness, lattice), lattice) < settings.scatter_inside
        or _scatter_inside(measure_radial_profile(brightness, lattice, light=light), lattice) < settings.scatter_of_lit
    )


def _scatter_inside(profile: RadialProfile, lattice: Lattice) -> float:
    """Scatter inside the microimages over the depth of the gaps."""
    radii = np.arange(len(profile.mean)) * profile.step
    inner = radii < 0.5 * lattice.radius
    noise = float(np.sqrt(np.average(profile.variance[inner], weights=radii[inner] + profile.step)))
    return noise / max(float(np.ptp(profile.mean)), 1e-12)
