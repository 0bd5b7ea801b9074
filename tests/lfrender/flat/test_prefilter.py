"""Prefilter for bilinear interpolation: contrast that it keeps, and exact rounding."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from lfrender.flat.prefilter import pack_flat, prefilter_flat


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("channels", [1, 3])
def test_interpolation_of_the_prefiltered_flat_keeps_the_contrast_of_fine_detail(dtype, channels):
    top = 1.0 if dtype is np.float32 else np.iinfo(dtype).max
    x = np.arange(120) * np.ones((120, 1))
    wave = 2 * np.pi * 0.15
    flat = (top * (0.5 + 0.4 * np.cos(wave * x))).astype(dtype)[:, :, None].repeat(channels, 2)
    ready = prefilter_flat(flat)
    assert ready.dtype == dtype and ready.shape == flat.shape
    at = np.random.default_rng(0).uniform(5, 114, (2, 20000))

    def contrast(pixels):
        read = map_coordinates(pixels[:, :, 0].astype(float), at, order=1) / top
        return 2 * ((read - 0.5) * np.cos(wave * at[1])).mean() / 0.4

    assert contrast(ready) == pytest.approx(1, abs=0.02)
    assert contrast(flat) < 0.95


@pytest.mark.parametrize("shape", [(7, 90, 3), (3, 1, 3), (5, 2, 3), (1, 9, 4), (6, 40, 1)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_integers_are_filtered_exactly_and_rounded(shape, dtype):
    flat = (
        np.random.default_rng(0)
        .choice([0, 1, 3, np.iinfo(dtype).max - 1, np.iinfo(dtype).max], shape)
        .astype(dtype)
    )
    wide = np.pad(flat.astype(np.int64), ((1, 1), (1, 1), (0, 0)), mode="edge")
    beside = wide[:-2, 1:-1] + wide[2:, 1:-1] + wide[1:-1, :-2] + wide[1:-1, 2:]
    wanted = np.clip(
        np.maximum(16 * wide[1:-1, 1:-1] - beside + 6, 0) // 12, 0, np.iinfo(dtype).max
    )
    np.testing.assert_array_equal(prefilter_flat(flat), wanted)


@pytest.mark.parametrize("sharpened", [True, False])
@pytest.mark.parametrize("channels", [1, 2, 3])
def test_packed_pixels_hold_the_bytes_of_the_flat(channels, sharpened):
    flat = np.random.default_rng(8).integers(0, 256, (37, 53, channels), dtype=np.uint8)
    packed = pack_flat(flat, sharpened)
    assert packed.dtype == np.uint32 and packed.shape == (37, 53)
    bytes_of = packed.view(np.uint8).reshape(37, 53, 4)
    np.testing.assert_array_equal(
        bytes_of[:, :, :channels], prefilter_flat(flat) if sharpened else flat
    )
    assert not bytes_of[:, :, channels:].any()
