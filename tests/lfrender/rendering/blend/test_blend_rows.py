"""Blending row by row gives the picture of blending pixel by pixel, in any part and on any number
of threads.
"""

import functools

import numba
import numpy as np
import pytest

import lfrender
from data_synth import SCENES, Camera, simulate


@functools.cache
def capture():
    camera = Camera.design(size=(300, 220), pitch=17.3, rotation=2.1)
    shot = simulate(SCENES["house"](camera), camera, samples=24, seed=2)
    return (
        shot.flat,
        shot.truth.calibration,
        lfrender.analyze(shot.flat, shot.truth.calibration, "fast"),
    )


def shorts(flat):
    """The same in 16 bits, with lower bits set."""
    return flat * np.uint16(257) - np.random.default_rng(3).integers(
        0, 200, flat.shape, np.uint16
    ) % (flat + np.uint16(1))


def view(flat, camera, depth, scale):
    return next(lfrender.views(flat, camera, depth, offsets=[(3.0, -2.0)], scale=scale))


def middle(flat, camera, depth, scale):
    return lfrender.render(flat, camera, depth, scale=scale, detail="off")


def nearest(flat, camera, depth, scale):
    return lfrender.render(flat, camera, depth, scale=scale, blend=False)


# At the larger scale a lens shows more pixels of a row than are worked on together.
@pytest.mark.parametrize("made", [np.asarray, shorts])
@pytest.mark.parametrize("drawn", [middle, view, nearest])
@pytest.mark.parametrize(("channels", "scale"), [(1, None), (3, None), (3, 45.0)])
def test_pictures_of_integers_are_those_of_floats(channels, scale, drawn, made):
    flat, camera, depth = capture()
    flat = made(flat.reshape(*flat.shape[:2], -1)[:, :, :1].repeat(channels, 2))
    rows = drawn(flat, camera, depth, scale)
    # Floats are blended pixel by pixel.
    pixels = drawn(flat / np.float32(np.iinfo(flat.dtype).max), camera, depth, scale)
    apart = np.abs(rows.image / np.float64(np.iinfo(flat.dtype).max) - pixels.image) * 255
    np.testing.assert_array_equal(rows.valid, pixels.valid)
    # The flat is rounded to grey levels, and clipped, when the blur of interpolation is
    # compensated.
    assert apart.mean() < 0.4
    assert (apart > 1.5).mean() < 3e-3


@pytest.mark.parametrize("made", [np.asarray, shorts])
def test_blended_rows_have_the_same_bits_on_one_thread_and_two_and_in_a_part(made):
    flat, camera, depth = capture()
    flat = made(flat)
    threads = numba.get_num_threads()
    whole = lfrender.render(flat, camera, depth)
    try:
        numba.set_num_threads(1)
        alone = lfrender.render(flat, camera, depth)
    finally:
        numba.set_num_threads(threads)
    np.testing.assert_array_equal(alone.image, whole.image)
    part = lfrender.render(flat, camera, depth, roi=(61.0, 50.0, 191.0, 140.0))
    left, top = np.rint((part.affine[:, 2] - whole.affine[:, 2]) / whole.affine[0, 0]).astype(int)
    rows, columns = part.valid.shape
    np.testing.assert_array_equal(part.image, whole.image[top : top + rows, left : left + columns])
