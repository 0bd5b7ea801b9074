"""Microimages cut out, smoothed and with their slopes."""

import numpy as np
import pytest
from scipy.ndimage import correlate1d

from lfrender.depth.refinement.pair_pixels import cut_smoothed, pixel_raster


@pytest.mark.parametrize(("left", "top"), [(1, 1), (7, 4), (11, 8)])
def test_microimages_are_cut_out_smoothed_with_their_slopes(left, top):
    height, width, side, stride = 18, 21, 9, 12
    image = np.random.default_rng(2).random((height, width)).astype(np.float32)
    raster = pixel_raster(np.float32(4.2))
    assert (raster.side, raster.stride) == (side, stride)
    cutout, work = np.full((4, raster.size), np.nan, np.float32), np.zeros((2, raster.size), np.float32)
    cut_smoothed(image.ravel(), height, width, side, stride, left, top, *work, *cutout)
    kernel = np.array([1, 4, 1]) / 6
    expected = correlate1d(correlate1d(image.astype(float), kernel, 0, mode="nearest"), kernel, 1, mode="nearest")
    slopes = [correlate1d(expected, [-0.5, 0, 0.5], axis, mode="nearest") for axis in (1, 0)]
    laplacian = sum(correlate1d(expected, [1, -2, 1], axis, mode="nearest") for axis in (0, 1))
    part = slice(top, top + side), slice(left, left + side)
    for found, whole in zip(cutout, (expected, *slopes, laplacian), strict=True):
        np.testing.assert_allclose(found[: side * stride].reshape(side, stride)[:, :side], whole[part], atol=1e-6)
