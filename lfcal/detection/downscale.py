"""Very large flats are calibrated on averages of square blocks of pixels: a lattice does not need every pixel."""

from __future__ import annotations

from contextlib import suppress
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
    "ENOUGH",
    "LARGE",
    "PIECES",
    "average_blocks",
    "choose_block_size",
    "is_large_after_averaging",
    "is_searched_at_half_size",
    "is_searched_in_pieces",
    "upscale_calibration",
]

# [px] flats of more are averaged in blocks,
LARGE = 4.8e7
# down to about so many.
ENOUGH = 1.6e7
# White images of fewer are as soon calibrated as a whole as in pieces.
PIECES = 6e6


def choose_block_size(flat: NDArray[Any]) -> int:
    """Side [px] of the blocks that a flat (h, w) or (h, w, 3) is to be averaged in: 1 where it is not large.

    Raises
    ------
    CalibrationError
        If a large flat shows no lattice in its middle, nor beside it.
    """
    height, width = flat.shape[:2]
    if height * width < LARGE:
        return 1
    from ..images.mosaic import find_mosaic

    pitch = _find_pitch(flat)
    block = max(1, min(int(pitch / 9), round(np.sqrt(height * width / ENOUGH))))
    # Whole cells of a colour mosaic average to grey.
    return block - block % 2 if block > 1 and find_mosaic(flat) else block


def _find_pitch(flat: NDArray[Any]) -> float:
    """Pitch [px] in the first part of a flat that shows one; the array need not fill the sensor."""
    from ..images.preprocessing import luminance, sqrt_luminance
    from .first_lattice import find_first_lattice

    height, width = flat.shape[:2]

    def pitch_in_part(across: float, down: float, side: int) -> float:
        left, top = int(across * max(0, width - side)), int(down * max(0, height - side))
        part = np.ascontiguousarray(flat[top : top + side, left : left + side])
        return find_first_lattice(sqrt_luminance(luminance(part))).lattice.pitch

    # In the middle first, where twelve pitches across are enough; then in larger parts.
    with suppress(CalibrationError):
        pitch = pitch_in_part(0.5, 0.5, 1024)
        if pitch * 12 < 1024:
            return pitch
    error: CalibrationError | None = None
    for across, down in ((0.5, 0.5), (0.2, 0.5), (0.8, 0.5), (0.5, 0.2), (0.5, 0.8)):
        try:
            return pitch_in_part(across, down, 2400)
        except CalibrationError as failure:
            error = error or failure
    assert error is not None
    raise error


def is_searched_in_pieces(size: tuple[int, int]) -> bool:
    """Whether the lattice of a white image of `size` (width, height) is first looked for in a piece of it."""
    return size[0] * size[1] >= PIECES


def is_large_after_averaging(size: tuple[int, int], block: int) -> bool:
    """Whether a flat of `size` (width, height) is large even when averaged in blocks."""
    return size[0] * size[1] / block**2 >= LARGE


def is_searched_at_half_size(size: tuple[int, int]) -> bool:
    """Whether the first lattice of a flat of `size` (width, height) is looked for at half that size."""
    return size[0] * size[1] >= 3e6


def average_blocks(flat: NDArray[Any], block: int, rows: int = 32) -> NDArray[np.float32]:
    """(h // block, w // block) mean luminance of the blocks of a flat; `rows` of them at a time, to save memory."""
    import cv2

    from ..images.preprocessing import luminance

    height, width = flat.shape[0] // block, flat.shape[1] // block
    out = np.empty((height, width), np.float32)
    for top in range(0, height, rows):
        count = min(rows, height - top)
        strip = luminance(np.ascontiguousarray(flat[top * block : (top + count) * block, : width * block]))
        out[top : top + count] = cv2.resize(strip, (width, count), interpolation=cv2.INTER_AREA)
    return out


def upscale_calibration(camera: Calibration, block: int, image_size: tuple[int, int]) -> Calibration:
    """Calibration of a flat from that of its averages.

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
        None if small.distortion is None else _upscale_distortion(small.distortion, block, shift),
    )  # fmt: skip
    vignetting = camera.vignetting and Vignetting(camera.vignetting.profile, camera.vignetting.step * block)
    gain = None if camera.gain_map is None else _upscale_gain(camera.gain_map, small, lattice, block)
    # Averages show no defects of single pixels.
    defects = Defects(lenses=camera.defects.lenses)
    residual = camera.residual_rms * block
    return replace(
        camera, lattice=lattice, vignetting=vignetting, gain_map=gain, defects=defects, residual_rms=residual,
        errors=camera.errors and camera.errors.scaled(block),
        residuals=camera.residuals and camera.residuals.scaled(block),
    )  # fmt: skip


def _upscale_distortion(bend: Distortion, block: int, shift: float) -> Distortion:
    return Distortion(
        bend.centre * block + shift, bend.k1, bend.k2, bend.reach * block,
        None if bend.general is None else bend.general * block,
        None if bend.middle is None else bend.middle * block + shift,
    )  # fmt: skip


def _upscale_gain(gain: GainMap, small: Lattice, lattice: Lattice, block: int) -> GainMap:
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
