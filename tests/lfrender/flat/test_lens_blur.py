"""Flats that JPEG has taken detail from do not tell the blur of the microlenses."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import lfrender
from lfrender.flat.lens_blur import has_blocks


@pytest.mark.parametrize(("quality", "seen"), [(50, True), (75, True), (None, False)])
def test_blocks_of_jpeg_are_seen(quality, seen):
    noise = np.random.default_rng(0).normal(0, 255, (400, 400, 1))
    flat = np.clip(128 + cv2.GaussianBlur(noise, (0, 0), 2.0), 0, 255).astype(np.uint8)
    if quality is not None:
        coded = cv2.imencode(".jpg", flat, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        flat = np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE))
    flat = flat.reshape(400, 400, 1)
    assert has_blocks(flat) == seen


def test_a_pattern_in_one_direction_is_no_block_of_jpeg():
    stripes = 60.0 * (np.arange(400) // 8 % 2)
    noise = np.random.default_rng(0).normal(90, 20, (400, 400, 1))
    columns = noise + stripes[:, None]
    assert not has_blocks(columns)
    assert not has_blocks(columns.swapaxes(0, 1))
    assert has_blocks(columns + stripes[:, None, None])


def test_the_depth_map_keeps_the_blur_in_its_file(tmp_path):
    from dataclasses import replace

    from lfcal import LensBlur

    depth = lfrender.data.example()[2]
    blur = LensBlur(
        6.0,
        1.2,
        np.array([0.1]),
        np.array([0.1]),
        np.array([-0.3]),
        np.ones((1, 1)),
        np.ones((1, 1)),
    )
    replace(depth, lens_blur=blur).save(tmp_path / "depth.npz")
    assert lfrender.DepthMap.load(tmp_path / "depth.npz").lens_blur.to_dict() == blur.to_dict()
    replace(depth, lens_blur=None).save(tmp_path / "none.npz")
    assert lfrender.DepthMap.load(tmp_path / "none.npz").lens_blur is None
