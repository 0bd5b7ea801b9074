"""Reused memory belongs to one thread, and results never lie in it."""

from __future__ import annotations

import numpy as np

import lfrender
from data_synth import SCENES, Camera, simulate
from lfrender.runtime.buffers import allocate_pooled


def test_the_next_frame_does_not_change_depth_and_picture_of_the_last_one():
    camera = Camera.design((320, 240), 23.2)
    shot = simulate(SCENES["house"](camera), camera, samples=8, seed=2)
    flat = shot.flat
    camera = shot.truth.calibration
    depth = lfrender.analyze(flat, camera, "fast")
    picture = lfrender.render(flat, camera, depth)
    kept = depth.surface.patch_size.copy(), depth.patch_size.copy(), picture.image.copy()
    other = np.ascontiguousarray(flat[::-1, ::-1])
    lfrender.render(other, camera, lfrender.analyze(other, camera, "fast"))
    np.testing.assert_array_equal(depth.surface.patch_size, kept[0])
    np.testing.assert_array_equal(depth.patch_size, kept[1])
    np.testing.assert_array_equal(picture.image, kept[2])


def test_pooled_memory_is_reused_only_when_no_array_refers_to_it():
    first = allocate_pooled((300, 200), np.int16)
    part = first[10:20].T
    place = first.ctypes.data
    del first
    others = [allocate_pooled((300, 200), np.int16) for _ in range(5)]
    assert place not in [other.ctypes.data for other in others]
    del part
    # A slightly smaller array fits.
    assert allocate_pooled((200, 290), np.int16).ctypes.data == place


def test_pooled_memory_is_not_used_for_much_smaller_arrays_nor_kept_above_the_limit():
    large = allocate_pooled((1 << 20,), np.int64)
    place = large.ctypes.data
    del large
    assert allocate_pooled((1 << 18,), np.int64).ctypes.data != place
    # A pooled array would be a view.
    assert allocate_pooled((1 << 24, 2), np.int64).base is None
