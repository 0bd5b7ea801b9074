"""Pictures coarser than the flat: neither blurred twice nor aliased."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.ndimage import map_coordinates, uniform_filter

import lfrender
from lfcal import Calibration, Lattice
from lfrender.flat.lens_blur import measure_lens_blur
from lfrender.flat.prefilter import prefilter_flat, prefilter_packed

SIZE, PITCH = (420, 330), 21.0
# Texels of the scene per flat pixel, and its margin [flat px].
FINE, MARGIN = 3, 40


@functools.cache
def scene():
    """Overlapping rectangles of all sizes: edges everywhere, as in photographs."""
    rng = np.random.default_rng(4)
    height, width = ((n + 2 * MARGIN) * FINE for n in SIZE[::-1])
    picture = np.zeros((height, width), np.float32)
    for _ in range(9000):
        w, h = np.minimum(8 / rng.uniform(0.02, 1, 2), 120).astype(int)
        x, y = rng.integers(0, width), rng.integers(0, height)
        picture[y : y + h, x : x + w] = rng.uniform(0.1, 0.9)
    return picture


@functools.cache
def camera():
    return Calibration(Lattice((209.3, 164.6), [[PITCH, 0.3], [PITCH / 2, PITCH * 0.75**0.5]], SIZE, 10.0))


@functools.cache
def flat_of(s, blur=0.0):
    """The flat of a plane at patch size `s`, whose lenses average the scene over `blur` flat px."""
    lattice = camera().lattice
    # What a pixel and the blur average, on the texels of the scene.
    ratio = lattice.pitch / abs(s) * FINE
    texture = uniform_filter(uniform_filter(scene(), max(1, round(ratio))), max(1, round(blur * ratio)))
    y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(float)
    points = np.stack([x, y], -1).reshape(-1, 2)
    own = lattice.origin + np.rint(lattice.to_index(points)) @ lattice.basis
    where = own - (points - own) * lattice.pitch / s
    return map_coordinates(texture, ((where + MARGIN) * FINE + 1)[:, ::-1].T, order=1).reshape(y.shape)


def distance_from_scene(picture):
    """RMS difference from the mean of the scene over each output pixel, two pitches off the border."""
    side = picture.affine[0, 0]
    wide = uniform_filter(scene(), round(side * FINE))
    v, u = np.mgrid[: picture.image.shape[0], : picture.image.shape[1]]
    where = np.stack([v, u]) * side + picture.affine[0, 2]
    wanted = map_coordinates(wide, (where + MARGIN) * FINE + 1, order=1)
    border = int(np.ceil(2 * picture.scale))
    return np.sqrt(np.mean((picture.image - wanted)[border:-border, border:-border] ** 2))


@pytest.mark.parametrize("s", [-10.0, 6.0])
@pytest.mark.parametrize("blur", [0.0, 2.0, 3.0])
def test_the_width_lenses_have_averaged_over_is_measured(s, blur):
    sizes = np.full(len(camera().lattice), s, np.float32)
    width = measure_lens_blur(flat_of(s, blur)[:, :, None], camera(), sizes) * abs(s)
    assert width == pytest.approx(blur, abs=0.5)


def test_noise_is_not_taken_for_sharpness_or_blur():
    sizes = np.full(len(camera().lattice), 8.0, np.float32)
    noise = np.random.default_rng(1).normal(0.5, 0.1, (*SIZE[::-1], 1)).astype(np.float32)
    assert measure_lens_blur(noise, camera(), sizes) == 0
    assert measure_lens_blur(np.full((*SIZE[::-1], 1), 0.5, np.float32), camera(), sizes) == 0


@pytest.mark.parametrize("blur", [0.0, 3.0])
def test_a_coarse_picture_is_the_mean_over_its_pixels_whether_lenses_blur_or_not(blur):
    s = -10.0
    coarse = [lfrender.render(flat_of(s, blur), camera(), patch_size=s, blend=True, scale=10 / n) for n in (3, 4, 5)]
    assert max(distance_from_scene(picture) for picture in coarse) < 0.02


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("channels", [1, 3])
def test_reading_between_pixels_keeps_the_contrast_of_fine_detail(dtype, channels):
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
def test_what_interpolation_blurs_is_given_back_exactly_rounded(shape, dtype):
    flat = np.random.default_rng(0).choice([0, 1, 3, np.iinfo(dtype).max - 1, np.iinfo(dtype).max], shape).astype(dtype)
    wide = np.pad(flat.astype(np.int64), ((1, 1), (1, 1), (0, 0)), mode="edge")
    beside = wide[:-2, 1:-1] + wide[2:, 1:-1] + wide[1:-1, :-2] + wide[1:-1, 2:]
    wanted = np.clip(np.maximum(16 * wide[1:-1, 1:-1] - beside + 6, 0) // 12, 0, np.iinfo(dtype).max)
    np.testing.assert_array_equal(prefilter_flat(flat), wanted)


@pytest.mark.parametrize("channels", [1, 2, 3])
def test_packed_pixels_hold_the_bytes_that_are_ready_to_read(channels):
    flat = np.random.default_rng(8).integers(0, 256, (37, 53, channels), dtype=np.uint8)
    packed = prefilter_packed(flat)
    assert packed.dtype == np.uint32 and packed.shape == (37, 53)
    bytes_of = packed.view(np.uint8).reshape(37, 53, 4)
    np.testing.assert_array_equal(bytes_of[:, :, :channels], prefilter_flat(flat))
    assert not bytes_of[:, :, channels:].any()
