"""Candidates of the lattice of a camera on its flats, the likeliest first, each with its final fit."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .detection.capture_kind import choose_white_or_scene
from .detection.first_lattice import (
    NO_MICROIMAGES,
    REPEATABILITY,
    FirstLattice,
    find_first_lattices,
    find_stated_lattices,
)  # fmt: skip
from .images.mosaic import remove_mosaic
from .images.preprocessing import sqrt_luminance
from .images.stack import average_scenes, combine_whites, select_contrasted
from .lattice.lens_subset import ReadCrop, StackedCrops
from .lattice.stated import LatticeHint
from .lattice_fit import FinalLattice, fit_lattice_to_scenes, fit_lattice_to_white_image
from .runtime.errors import RAW_FLAT_ADVICE, CalibrationError

__all__ = [
    "LatticeCandidate", "find_lattice_in_crops", "find_lattice_in_piece", "find_lattices",
    "find_lattices_without_glare",
]  # fmt: skip


@dataclass(frozen=True)
class LatticeCandidate:
    """A lattice and the picture it was found on."""

    picture: NDArray[np.float32] | StackedCrops  # (h, w) root of the luminance, or crops of a white image
    white: bool  # the flat is a white image
    start: FirstLattice
    fit: FinalLattice
    read_crop: ReadCrop | None = None  # reads any part of the flat, where `picture` are crops
    single: NDArray[np.float32] | None = None  # (h, w) one of several scenes, where `picture` is their mean
    # (h, w) `picture` with less contrast, where the lattice was found on that
    softened: NDArray[np.float32] | None = None
    stated: bool = False  # the pitch was given beforehand: these are microimages


def find_lattice_in_crops(flat: NDArray[Any], kind: str, has_mosaic: bool) -> LatticeCandidate | None:
    """The lattice of a very large white image from crops of it; None where it is none."""
    from .white_fit.large import find_white_lattice, sample_parts, window_reader

    read_crop = window_reader(flat, has_mosaic)
    start = find_white_lattice(read_crop, (flat.shape[1], flat.shape[0]), kind == "white", tries=9)
    if start is None:
        return None
    crops, read_crop = sample_parts(read_crop, start.lattice)
    return LatticeCandidate(crops, True, start, fit_lattice_to_white_image(crops, start), read_crop)


def find_lattice_in_piece(flat: NDArray[Any], kind: str) -> LatticeCandidate | None:
    """The lattice of a large white image, from its middle outwards; None where it is none."""
    from .white_fit.large import find_white_lattice_in_array

    picture = sqrt_luminance(flat)
    start = find_white_lattice_in_array(picture, kind == "white")
    if start is None:
        return None
    return LatticeCandidate(picture, True, start, fit_lattice_to_white_image(picture, start))


def find_lattices(
    lights: list[NDArray[np.float32]], kind: str, has_mosaic: bool, hint: LatticeHint | None = None
) -> Iterator[LatticeCandidate]:
    """Lattices of whole flats of luminance `lights` (h, w), the likeliest first; CalibrationError if there are none."""
    single = sqrt_luminance(lights[0]) if len(lights) == 1 else None
    if len(lights) > 1:
        lights = [lights[k] for k in select_contrasted(lights)]
    error: CalibrationError | None = None
    none = True
    for start in _find_starts(lights, has_mosaic, single, hint):
        try:
            white, chosen = choose_white_or_scene(lights, start, kind)
            if white:
                picture = sqrt_luminance(combine_whites(chosen)) if single is None else single
                found = LatticeCandidate(picture, True, start, fit_lattice_to_white_image(picture, start))
            else:
                chosen = [remove_mosaic(light) for light in chosen] if has_mosaic else chosen
                picture = sqrt_luminance(_mean_scene(chosen)) if single is None or has_mosaic else single
                one = None if len(chosen) == 1 else sqrt_luminance(chosen[0])
                fit = fit_lattice_to_scenes(chosen, picture, start)
                found = LatticeCandidate(picture, False, start, fit, single=one)
        except CalibrationError as failure:
            error = error or start.doubt or failure
            continue
        except np.linalg.LinAlgError as failure:
            # The lattice is not determined in one of the directions.
            text = f"what repeats on the image has no edges to place microimages by; {RAW_FLAT_ADVICE}"
            raise (error or CalibrationError(text)) from failure
        none = False
        yield found if hint is None else replace(found, stated=True)
    if none and error is not None:
        raise error


def find_lattices_without_glare(
    found: LatticeCandidate, others: Iterator[LatticeCandidate], lights: Callable[[], list[NDArray[np.float32]]],
    has_mosaic: bool,
) -> tuple[LatticeCandidate, Iterator[LatticeCandidate]]:  # fmt: skip
    """The lattices of scenes, or those on the root of their luminance where bright places may outweigh microimages.

    Those on the root are taken where contrast is high or their average microimage is rounder, if gaps are not clear.
    """
    # A ninth of the pixels is enough. Files with gamma have up to 0.46, linear ones up to 0.9.
    glares = float(np.asarray(found.picture)[::3, ::3].std()) > 0.5
    if found.start.clear_gaps or (not glares and found.start.roundness >= 0.55):
        return found, others

    def find_softer() -> Iterator[LatticeCandidate]:
        for one in find_lattices([np.sqrt(light) for light in lights()], "scene", has_mosaic):
            assert isinstance(one.picture, np.ndarray)
            yield replace(one, picture=found.picture, softened=one.picture)

    softer = find_softer()
    try:
        first = next(softer)
    except CalibrationError:
        return found, others
    return (first, softer) if glares or first.start.roundness > found.start.roundness else (found, others)


def _mean_scene(lights: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    return average_scenes(lights) if len(lights) > 1 else lights[0]


def _find_starts(
    lights: list[NDArray[np.float32]], has_mosaic: bool, single: NDArray[np.float32] | None, hint: LatticeHint | None
) -> Iterator[FirstLattice]:
    """First lattices on the mean of the lights, or on the first of them that has one by itself.

    `single` is the root of the only one.
    """
    error: CalibrationError | None = None
    found = False
    for k in range(-1, len(lights) if len(lights) > 1 else 0):
        picture = single
        if picture is None or has_mosaic:
            light = _mean_scene(lights) if k < 0 else lights[k]
            picture = sqrt_luminance(remove_mosaic(light) if has_mosaic else light)
        try:
            for start in _find_starts_on(picture, hint):
                found = True
                yield start
        except CalibrationError as failure:
            error = error or failure
        if found:
            return
    assert error is not None
    raise error


def _find_starts_on(picture: NDArray[np.float32], hint: LatticeHint | None) -> Iterator[FirstLattice]:
    import cv2

    mean, deviation = (float(value[0, 0]) for value in cv2.meanStdDev(picture))
    if mean == 0 or deviation < 1e-4 * mean:
        raise CalibrationError("the image is one even grey; give a flat with light on it and without saturation")
    if hint is not None:
        yield from find_stated_lattices(picture, hint)
        return
    for start in find_first_lattices(picture):
        if start.repeatability < REPEATABILITY and not start.confirmed:
            raise CalibrationError(NO_MICROIMAGES)
        yield start
