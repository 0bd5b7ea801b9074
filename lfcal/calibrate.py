"""Calibrate a focused plenoptic camera from its flats, white or scene, with nothing else given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .bayer import Mosaic, check_mosaic, equalise, has_mosaic, without_mosaic
from .calibration import Calibration
from .errors import CalibrationError, FlatError
from .lattice import Lattice

if TYPE_CHECKING:
    from .search import FirstLattice

__all__ = ["calibrate"]

# Two halves of a flat must show average microimages that correlate at least so much.
_REPEATS = 0.8
# Halves that put the lattice further apart than this share of the pitch have not found one.
_SCATTERED = 0.1
# Window, in pitches, in which breaks are levelled: wider than a rim, narrower than what the scene shows in a lens.
_RIM = 0.5
# A fit that leaves the first lattice by more than this share of the pitch (RMS) has followed something else.
_FOLLOWED = 0.2
# Rims that scatter the halves by more than this share of the pitch are faint.
_FAINT = 0.03
# Window, in pitches, in which brightness is levelled to see whether microimages are evenly lit.
_LEVEL = 2.0
# Below this confidence a person should look.
_SURE = 0.7
# Scatter inside the microimages of a white image, as a share of the depth of the gaps.
_EVEN_INSIDE = 0.15
# Relative spread of the tones of an image that shows nothing.
_EVEN = 1e-4


def calibrate(
    image: ArrayLike | Sequence[ArrayLike],
    kind: Literal["auto", "white", "scene"] = "auto",
    mosaic: Mosaic | None = None,
) -> Calibration:
    """Find the microlens lattice on one or more flats of a camera.

    Parameters
    ----------
    image : (h, w) or (h, w, 3) array_like, any integer or float type, or a sequence of such
        Raw sensor picture: a white image or any scene. Several are combined: white images add up, each weighted by
        its exposure and without its clipped pixels; of scenes the breaks between microimages are averaged. Flats
        that show nothing, such as dark or saturated ones, are left out.
    kind : {"auto", "white", "scene"}
        What the flats show; `"auto"` decides by whether microimages are evenly lit inside. Where some of several are
        white images, only these are used.
    mosaic : {"RGGB", "BGGR", "GRBG", "GBRG"} or None
        Colour filters over the top left 2 x 2 pixels of a flat (h, w). With None a mosaic is detected and taken out,
        but which colour is where cannot be told from it and is not kept.

    Returns
    -------
    Calibration
        Its `confidence` is the weakest of several independent tests; below 0.7 there is also a warning.

    Raises
    ------
    FlatError
        If an image cannot be a flat: wrong shape, NaN, too small, or of another size than the first.
    CalibrationError
        If no trustworthy lattice is on it.
    """
    if kind not in ("auto", "white", "scene"):
        raise ValueError(f"kind must be 'auto', 'white' or 'scene', got {kind!r}")
    flats = _flats(image)
    for flat in flats:
        check_mosaic(mosaic, flat)
    # Compiled code is loaded only when a flat is there to be calibrated.
    from .features import luminance, tone
    from .type_search import find_lens_types
    from .vignetting import measure_vignetting

    filtered = mosaic is not None or all(flat.ndim == 2 and has_mosaic(flat) for flat in flats)
    lights = [equalise(flat) if filtered else luminance(flat) for flat in flats]
    if len(lights) > 1:
        lights = _telling(lights)
    start = _first(lights, filtered)
    white, lights = _sorted(lights, start, kind)
    if white:
        picture = tone(_white_sum(lights))
        fit = _fit_white(picture, start)
    else:
        lights = [without_mosaic(light) for light in lights] if filtered else lights
        picture = tone(_mean_scene(lights))
        fit = _fit_scene(lights, picture, start)
    lattice, residual, lenses, differ = fit
    if not differ < _SCATTERED * lattice.pitch:
        raise CalibrationError(
            f"two halves of the microimages of {lattice.pitch:.1f} px pitch disagree about the lattice; "
            "give a sharper flat or a white image"
        )
    vignetting, radius = measure_vignetting(picture, lattice)
    lattice = replace(lattice, radius=radius)
    types = find_lens_types(picture, lattice, white)
    confidence = float(np.clip(min(start.repeatability, 1 - differ / (_SCATTERED * lattice.pitch)), 0, 1))
    warnings = []
    if confidence < _SURE:
        warnings.append(
            f"the lattice is uncertain (confidence {confidence:.2f}, halves of the flat differ by {differ:.2f} px); "
            "check the circles on the flat or calibrate on a white image"
        )
    if types is not None and not types.ordered:
        warnings.append(
            f"{types.count} lens types were told apart, but not which is focused at which depth; "
            "calibrate on a scene with detail at several depths"
        )
    if filtered and mosaic is None:
        warnings.append(
            "the flat has a colour filter mosaic, taken out here; say which one (--mosaic RGGB, BGGR, GRBG or GBRG) "
            "to have it kept in the camera file"
        )
    return Calibration(
        lattice,
        vignetting,
        "white" if white else "scene",
        residual,
        lenses,
        confidence,
        tuple(warnings),
        types,
        mosaic,
    )


def _flats(image: ArrayLike | Sequence[ArrayLike]) -> list[NDArray[Any]]:
    """The flats given, one or several, each checked."""
    given: Any = image
    several = isinstance(given, (list, tuple)) and len(given) > 0 and np.ndim(given[0]) >= 2
    if not several and np.ndim(given) != 4:
        return [_checked(given, "image")]
    if len(given) == 0:
        raise FlatError("no flat is given; give at least one")
    flats = [_checked(flat, f"flat {k}") for k, flat in enumerate(given, 1)]
    first = flats[0].shape
    for k, flat in enumerate(flats, 1):
        if flat.shape[:2] != first[:2]:
            raise FlatError(
                f"flat {k} is {flat.shape[1]} x {flat.shape[0]} px, flat 1 is {first[1]} x {first[0]} px; "
                "give flats of one camera"
            )
    return flats


def _checked(image: ArrayLike, name: str) -> NDArray[Any]:
    """The flat as an array, or FlatError saying what is wrong with it."""
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
    if min(flat.shape[:2]) < 16:
        raise FlatError(
            f"{name} of {flat.shape[1]} x {flat.shape[0]} px is too small to be a flat; give the whole sensor"
        )
    return flat


def _telling(lights: list[NDArray[np.float32]]) -> list[NDArray[np.float32]]:
    """The lights that show something."""
    from .combine import telling

    return [lights[k] for k in telling(lights)]


def _white_sum(lights: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    from .combine import white_sum

    return white_sum(lights)


def _mean_scene(lights: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    from .combine import mean_scene

    return mean_scene(lights) if len(lights) > 1 else lights[0]


def _first(lights: list[NDArray[np.float32]], filtered: bool) -> FirstLattice:
    """First lattice on the mean of the lights, or on the first of them that shows one by itself."""
    from .features import tone
    from .search import NO_MICROIMAGES, first_lattice

    error: CalibrationError | None = None
    tries = [lambda: _mean_scene(lights)] + [lambda light=light: light for light in lights] * (len(lights) > 1)
    for light in tries:
        picture = tone(without_mosaic(light()) if filtered else light())
        try:
            if float(picture.max()) == 0 or float(picture.std()) < _EVEN * float(picture.mean()):
                raise CalibrationError(
                    "the image is one even grey; give a flat with light on it and without saturation"
                )
            start = first_lattice(picture)
            # Two halves of a flat with microimages show the same average one.
            if start.repeatability < _REPEATS:
                raise CalibrationError(NO_MICROIMAGES)
            return start
        except CalibrationError as failure:
            error = error or failure
    assert error is not None
    raise error


def _sorted(
    lights: list[NDArray[np.float32]], start: FirstLattice, kind: str
) -> tuple[bool, list[NDArray[np.float32]]]:
    """Whether to calibrate on white images, and the lights to do it on."""
    if kind != "auto":
        return kind == "white", lights
    if len(lights) == 1:
        return _evenly_lit(start.brightness, start.lattice), lights
    from .features import level_locally, tone

    window = _LEVEL * start.lattice.pitch
    whites = [light for light in lights if _evenly_lit(level_locally(tone(light), window), start.lattice)]
    return (True, whites) if whites else (False, lights)


def _evenly_lit(brightness: NDArray[np.float32], lattice: Lattice) -> bool:
    """Whether the insides of microimages vary by little against the depth of the gaps between them."""
    from .fit import radial_profile

    profile = radial_profile(brightness, lattice)
    radii = np.arange(len(profile.mean)) * profile.step
    inner = radii < 0.5 * lattice.radius
    noise = float(np.sqrt(np.average(profile.variance[inner], weights=radii[inner] + profile.step)))
    depth = float(np.ptp(profile.mean))
    return noise < _EVEN_INSIDE * depth


def _fit_white(picture: NDArray[np.float32], start: FirstLattice) -> tuple[Lattice, float, int, float]:
    """Final lattice, residual of single lenses [px], lenses used, and disagreement of halves [px]."""
    from .disc_fit import fit_discs

    found = start.lattice
    discs = fit_discs(picture, found)
    index = found.indices()
    straight = replace(discs.lattice, distortion=None)
    apart = straight.points(np.rint(straight.to_index(found.points(index)))) - found.points(index)
    if not np.sqrt((apart**2).sum(1).mean()) < _FOLLOWED * found.pitch:
        return found, discs.residual_rms, discs.lenses_used, start.halves_differ
    return discs.lattice, discs.residual_rms, discs.lenses_used, discs.halves_differ


def _fit_scene(
    lights: list[NDArray[np.float32]], picture: NDArray[np.float32], start: FirstLattice
) -> tuple[Lattice, float, int, float]:
    """Final lattice, residual of single lenses [px], lenses used, and disagreement of halves [px].

    Only the breaks at the rims are what the lattice predicts: brightness also shows the scene, gaps that cut
    microimages have moved, and where a camera has flattened its pictures with another white image.
    """
    from .features import breaks, level_locally, tone
    from .scene_fit import fit_scene

    found = start.lattice
    rims = np.zeros(picture.shape, np.float32)
    for light in lights:
        single = picture if len(lights) == 1 else tone(light)
        rims += level_locally(breaks(single), _RIM * found.pitch) / np.float32(len(lights))
    fit = fit_scene(rims, found)
    if not fit.halves_differ < max(start.halves_differ, _FAINT * found.pitch):
        # Rims too faint for single lenses: what whole tiles have in common is the better measure.
        return found, fit.residual_rms, fit.lenses_used, start.halves_differ
    lattice = Lattice(fit.origin, fit.basis, found.image_size, found.radius)
    return lattice, fit.residual_rms, fit.lenses_used, fit.halves_differ
