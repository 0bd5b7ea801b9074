"""Very large flats: calibrated on averages of square blocks of pixels, since a lattice does not need every pixel."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..gain.defects import Defects
from ..gain.gain_map import GainMap
from ..gain.vignetting import Vignetting
from ..lattice.distortion import Distortion
from ..lattice.lattice import Lattice
from ..runtime.errors import CalibrationError

__all__ = [
    "average_blocks",
    "choose_block_size",
    "is_large_after_averaging",
    "is_searched_at_half_size",
    "is_searched_in_pieces",
    "upscale_calibration",
]

# Flats with more pixels than this are reduced, down to about so many, as long as the pitch stays this long [px].
_LARGE = 4.8e7
_ENOUGH = 1.6e7
# White images with fewer pixels are as soon seen as a whole as in pieces.
_PIECEWISE = 6e6
# Flats with fewer pixels are as soon searched at their own size.
_HALVED = 3e6
_LEAST_PITCH = 9.0
# Side of the part in which the pitch is looked for [px], where in the flat in turn, and rows averaged at a time.
_PART = 2400
# A smaller part will do where so many pitches are in it.
_SMALL_PART, _PERIODS = 1024, 12
_PLACES = ((0.5, 0.5), (0.2, 0.5), (0.8, 0.5), (0.5, 0.2), (0.5, 0.8))
_ROWS = 32


def choose_block_size(flat: NDArray[Any]) -> int:
    """Side [px] of the blocks that a flat (h, w) or (h, w, 3) is to be averaged in: 1 where it is not large.

    Raises
    ------
    CalibrationError
        If a large flat shows no lattice in its middle, nor beside it.
    """
    height, width = flat.shape[:2]
    if height * width < _LARGE:
        return 1
    from ..images.mosaic import has_mosaic

    block = max(1, min(int(_pitch(flat) / _LEAST_PITCH), round(np.sqrt(height * width / _ENOUGH))))
    # Whole cells of a colour mosaic average to grey.
    return block - block % 2 if block > 1 and flat.ndim == 2 and has_mosaic(flat) else block


def _pitch(flat: NDArray[Any]) -> float:
    """Pitch [px] in the first part of a flat that shows one; the array need not fill the sensor."""
    from ..images.preprocessing import luminance, sqrt_luminance
    from .first_lattice import find_first_lattice

    height, width = flat.shape[:2]
    error: CalibrationError | None = None
    # Most arrays show their pitch in a small part of the middle.
    left, top = max(0, width - _SMALL_PART) // 2, max(0, height - _SMALL_PART) // 2
    small = np.ascontiguousarray(flat[top : top + _SMALL_PART, left : left + _SMALL_PART])
    try:
        pitch = find_first_lattice(sqrt_luminance(luminance(small))).lattice.pitch
        if pitch * _PERIODS < _SMALL_PART:
            return pitch
    except CalibrationError:
        pass
    for across, down in _PLACES:
        left, top = int(across * max(0, width - _PART)), int(down * max(0, height - _PART))
        part = np.ascontiguousarray(flat[top : top + _PART, left : left + _PART])
        try:
            return find_first_lattice(sqrt_luminance(luminance(part))).lattice.pitch
        except CalibrationError as failure:
            error = error or failure
    assert error is not None
    raise error


def is_searched_in_pieces(size: tuple[int, int]) -> bool:
    """Whether the lattice of a white image of `size` (width, height) is sought in a piece of it first."""
    return size[0] * size[1] >= _PIECEWISE


def is_large_after_averaging(size: tuple[int, int], block: int) -> bool:
    """Whether a flat of `size` (width, height) is large even when reduced."""
    return size[0] * size[1] / block**2 >= _LARGE


def is_searched_at_half_size(size: tuple[int, int]) -> bool:
    """Whether the first lattice of a flat of `size` (width, height) is sought where that is half as large."""
    return size[0] * size[1] >= _HALVED


def average_blocks(flat: NDArray[Any], block: int) -> NDArray[np.float32]:
    """(h // block, w // block) mean luminance of the blocks of a flat, in strips that need little memory."""
    import cv2

    from ..images.preprocessing import luminance

    height, width = flat.shape[0] // block, flat.shape[1] // block
    out = np.empty((height, width), np.float32)
    for top in range(0, height, _ROWS):
        rows = min(_ROWS, height - top)
        strip = luminance(np.ascontiguousarray(flat[top * block : (top + rows) * block, : width * block]))
        out[top : top + rows] = cv2.resize(strip, (width, rows), interpolation=cv2.INTER_AREA)
    return out


def upscale_calibration(camera: Calibration, block: int, image_size: tuple[int, int]) -> Calibration:
    """The calibration of a flat from that of its reduction.

    Parameters
    ----------
    camera : Calibration
        Of the flat averaged in squares of `block` px.
    block : int [px]
    image_size : (int, int) [px]
        Width and height of the flat.
    """
    small = camera.lattice
    shift = (block - 1) / 2
    lattice = Lattice(
        small.origin * block + shift, small.basis * block, image_size, small.radius * block,
        None if small.distortion is None else _stretched(small.distortion, block, shift),
    )  # fmt: skip
    vignetting = camera.vignetting and Vignetting(camera.vignetting.profile, camera.vignetting.step * block)
    gain = None if camera.gain_map is None else _magnified(camera.gain_map, small, lattice, block)
    # Single pixels are not seen on a reduction.
    defects = Defects(lenses=camera.defects.lenses)
    residual = camera.residual_rms * block
    return replace(
        camera, lattice=lattice, vignetting=vignetting, gain_map=gain, defects=defects, residual_rms=residual,
        errors=camera.errors and camera.errors.scaled(block),
        residuals=camera.residuals and camera.residuals.scaled(block),
    )  # fmt: skip


def _stretched(bend: Distortion, block: int, shift: float) -> Distortion:
    return Distortion(
        bend.centre * block + shift, bend.k1, bend.k2, bend.reach * block,
        None if bend.general is None else bend.general * block,
        None if bend.middle is None else bend.middle * block + shift,
    )  # fmt: skip


def _magnified(gain: GainMap, small: Lattice, lattice: Lattice, block: int) -> GainMap:
    own = gain.lens_gain
    if len(own):
        known = {tuple(index): value for index, value in zip(small.indices().tolist(), own.tolist(), strict=True)}
        own = np.array([known.get(tuple(index), 1.0) for index in lattice.indices().tolist()], np.float32)
    return replace(
        gain,
        step=gain.step * block,
        radius=gain.radius * block,
        lens_gain=own,
        rim=gain.rim * block,
        cut=gain.cut * block,
    )  # fmt: skip
