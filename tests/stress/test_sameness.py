"""Results do not depend on the number of threads, nor on the run: bit for bit."""

from collections.abc import Iterator

import cv2
import numba
import numpy as np
import pytest

import lfcal
import lfrender
from benchmarks.stress.plane_flats import PlaneFlat
from benchmarks.white_images import WhiteImage
from data_synth import SCENES, Camera, simulate


@pytest.fixture(scope="module")
def clutter():
    camera = Camera.design(size=(360, 300), pitch=20.3, rotation=1.3)
    shot = simulate(SCENES["clutter"](camera), camera, samples=8, seed=3)
    return shot.flat, shot.truth.calibration


def _on_threads(call) -> Iterator[object]:
    most = numba.config.NUMBA_NUM_THREADS
    try:
        for threads in (most, most, 1):
            numba.set_num_threads(threads)
            cv2.setNumThreads(threads)
            yield call()
    finally:
        numba.set_num_threads(most)
        cv2.setNumThreads(-1)


@pytest.mark.parametrize("preset", ["fast", "balanced"])
def test_depth_and_picture_are_the_same_on_any_number_of_threads(clutter, preset):
    def call():
        depth = lfrender.analyze(*clutter, preset)
        return depth, lfrender.render(*clutter, depth)

    (depth, picture), *others = _on_threads(call)
    for other, drawn in others:
        for name in ("patch_size", "confidence", "standard_error", "filled_patch_size", "reason"):
            np.testing.assert_array_equal(getattr(other, name), getattr(depth, name), err_msg=name)
        np.testing.assert_array_equal(other.surface.patch_size, depth.surface.patch_size)
        np.testing.assert_array_equal(drawn.image, picture.image)


@pytest.mark.parametrize("kind", ["white", "scene"])
def test_cameras_are_the_same_on_any_number_of_threads(kind):
    if kind == "white":
        flat = WhiteImage(
            pitch=14.3, degrees=3.0, decibels=26, bits=8, strength=0.3, size=(260, 200)
        ).image()
    else:
        flat = PlaneFlat(pitch=16.0, size=(300, 260), fill=0.92, noise=0.01, kind="u1").flat()
    first, *others = _on_threads(lambda: lfcal.calibrate(flat, kind).to_dict())
    assert all(other == first for other in others)
