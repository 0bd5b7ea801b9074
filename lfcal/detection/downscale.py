"""Very large flats are calibrated on averages of square blocks of pixels: a lattice does not need
every pixel.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..camera.calibration import Calibration
from ..gain.gain_map import Defects, GainMap, Vignetting
from ..lattice.lattice import Lattice
from ..runtime.arrays import Array, Singles
from ..runtime.errors import CalibrationError

__all__ = [
    "LARGE",
    "PIECES",
    "average_blocks",
    "choose_block_size",
    "upscale_calibration",
]

# [px] flats of more are averaged in blocks, down to about a third.
LARGE = 4.8e7
# White images of fewer are as soon calibrated as a whole as in pieces.
PIECES = 6e6


def choose_block_size(flat: Array, has_mosaic: bool) -> int:
    """Side [px] of the blocks that a flat (h, w) or (h, w, 3) is averaged in; 1 unless it is large.

    Raises `CalibrationError` if a large flat shows no lattice in its middle, nor beside it.
    """
    height, width = flat.shape[:2]
    if height * width < LARGE:
        return 1
    pitch = _find_pitch(flat)
    block = max(1, min(int(pitch / 9), round(np.sqrt(3 * height * width / LARGE))))
    # Whole cells of a colour mosaic average to grey.
    return block - block % 2 if block > 1 and has_mosaic else block


def _find_pitch(flat: Array) -> float:
    """Pitch [px] in the first part of a flat that shows one; the array need not fill the sensor."""
    from ..images.preprocessing import luminance, sqrt_luminance
    from .search import find_candidates

    height, width = flat.shape[:2]
    error: CalibrationError | None = None
    small = 1024
    large = 2400
    beside = ((0.5, 0.5), (0.2, 0.5), (0.8, 0.5), (0.5, 0.2), (0.5, 0.8))
    for across, down, side in ((0.5, 0.5, small), *((*place, large) for place in beside)):
        left = int(across * max(0, width - side))
        top = int(down * max(0, height - side))
        part = np.ascontiguousarray(flat[top : top + side, left : left + side])
        try:
            pitch = find_candidates(sqrt_luminance(luminance(part)))[0].lattice.pitch
        except CalibrationError as failure:
            error = error or failure
            continue
        # Twelve pitches across are enough.
        if pitch * 12 < side or side == large:
            return pitch
    assert error is not None
    raise error


def average_blocks(flat: Array, block: int, rows: int = 32) -> Singles:
    """(h // block, w // block) mean luminance of the blocks of a flat; `rows` of them at a time, to
    save memory.
    """
    import cv2

    from ..images.preprocessing import luminance

    height = flat.shape[0] // block
    width = flat.shape[1] // block
    out = np.empty((height, width), np.float32)
    for top in range(0, height, rows):
        count = min(rows, height - top)
        strip = luminance(
            np.ascontiguousarray(flat[top * block : (top + count) * block, : width * block])
        )
        out[top : top + count] = cv2.resize(strip, (width, count), interpolation=cv2.INTER_AREA)
    return out


def upscale_calibration(
    camera: Calibration, block: int, image_size: tuple[int, int]
) -> Calibration:
    """Calibration of a flat of `image_size` (width, height) from that of its averages in squares of
    `block` px.
    """
    small = camera.lattice
    lattice = small.scaled(block, image_size)
    vignetting = camera.vignetting and Vignetting(
        camera.vignetting.profile, camera.vignetting.step * block
    )
    gain = (
        None if camera.gain_map is None else _upscale_gain(camera.gain_map, small, lattice, block)
    )
    # Averages show no defects of single pixels.
    defects = Defects(lenses=camera.defects.lenses)
    residual = camera.residual_rms * block
    return replace(
        camera,
        lattice=lattice,
        vignetting=vignetting,
        gain_map=gain,
        defects=defects,
        residual_rms=residual,
        errors=camera.errors and camera.errors.scaled(block),
        residuals=camera.residuals and camera.residuals.scaled(block),
    )


def _upscale_gain(gain: GainMap, small: Lattice, lattice: Lattice, block: int) -> GainMap:
    own = gain.lens_gain
    if len(own):
        known = {
            tuple(index): value
            for index, value in zip(small.indices().tolist(), own.tolist(), strict=True)
        }
        own = np.array(
            [known.get(tuple(index), 1.0) for index in lattice.indices().tolist()], np.float32
        )
    rim = gain.rim * block
    cut = gain.cut * block
    return replace(
        gain, step=gain.step * block, radius=gain.radius * block, lens_gain=own, rim=rim, cut=cut
    )
