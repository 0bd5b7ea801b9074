"""Compression in blocks is seen, and what it left of each frequency is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from lfrender.detail.compression import _left, find_blocks, kept_power

PLACES = np.stack(np.meshgrid(np.arange(20, 480, 23.0), np.arange(20, 480, 23.0)), -1).reshape(-1, 2)


def scene():
    """Edges and texture at all scales, soft as microimages are, with noise."""
    rng = np.random.default_rng(3)
    radius = np.hypot(np.fft.fftfreq(512)[:, None], np.fft.rfftfreq(512))
    wave = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((512, 512))) * np.maximum(radius, 0.01) ** -1.5)
    wave = cv2.GaussianBlur(wave, (0, 0), 0.8)
    return np.clip(128 + 45 * wave / wave.std() + rng.normal(0, 1.5, wave.shape), 0, 255).astype(np.uint8)


def coded(flat, quality):
    return cv2.imdecode(cv2.imencode(".jpg", flat, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_UNCHANGED)


def look_at(flat):
    return lambda part: flat[part[1] : part[3], part[0] : part[2], None]


def test_an_uncompressed_flat_has_no_blocks():
    assert find_blocks(look_at(scene()), PLACES) is None
    assert find_blocks(look_at(scene().astype(np.uint16) * 250), PLACES) is None


@pytest.mark.parametrize("quality", [50, 75, 95])
def test_blocks_begin_where_the_file_has_them(quality):
    flat = coded(scene(), quality)
    assert find_blocks(look_at(flat), PLACES) == (0, 0)
    assert find_blocks(look_at(flat[3:, 6:]), PLACES[:300]) == (2, 5)
    assert find_blocks(look_at(flat / np.float32(255)), PLACES) == (0, 0)


def test_share_that_rounding_leaves_of_laplace_distributed_values():
    values = np.random.default_rng(1).laplace(0, 1, 400_000)
    for step in (0.5, 2.0, 5.0):
        rounded = step * np.rint(values / step)
        true = ((values * rounded).mean() / (values**2).mean()) ** 2
        assert _left(np.array((rounded != 0).mean())) == pytest.approx(true, abs=0.02)


@pytest.mark.parametrize("quality", [50, 75, 90])
def test_what_compression_left_of_a_frequency_is_known(quality):
    flat, frequency = scene(), np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    made = coded(flat, quality)
    spectra = [np.fft.rfft2(one.astype(float) - one.mean()) for one in (flat, made)]
    radius = np.hypot(np.fft.fftfreq(512)[:, None], np.fft.rfftfreq(512))
    rings = [np.abs(radius - f) < 0.03 for f in frequency]
    cross, own = (np.array([(s * spectra[0].conj()).real[r].sum() for r in rings]) for s in spectra[::-1])
    found = kept_power(look_at(made), PLACES, (0, 0), frequency)
    np.testing.assert_allclose(found, (cross / own) ** 2, atol=0.15)
    assert found[0] > 0.95 > 0.5 > found[-1]
