"""Several flats of one camera: checked, combined to a better one; useless and over-exposed ones are
noticed.
"""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from lfcal.images.stack import estimate_white_level, measure_overexposure

_SIZE = (400, 320)


@pytest.fixture(scope="module")
def noisy(whites):
    """Four white images of one camera with much noise, their basis and origin."""
    basis = whites.turned(whites.HEXAGON, 14.3, 3)
    images = [whites.white_image(basis, _SIZE, noise=0.2, seed=seed) for seed in range(4)]
    return [image for image, _ in images], basis, images[0][1]


def _error(whites, camera, basis, origin):
    return whites.rms(whites.centre_errors(camera.lattice, origin, basis))


def test_four_white_images_halve_the_error_of_one(whites, noisy):
    images, basis, origin = noisy
    single = [
        _error(whites, lfcal.calibrate(image, kind="white"), basis, origin) for image in images[:2]
    ]
    together = lfcal.calibrate(images, kind="white")
    assert _error(whites, together, basis, origin) < 0.75 * np.sqrt(np.mean(np.square(single)))


def test_useless_flats_do_not_change_the_centres_of_a_good_one(whites):
    basis = whites.turned(whites.HEXAGON, 14.3, 3)
    good, origin = whites.white_image(basis, _SIZE)
    noise = np.random.default_rng(1).normal(600, 400, good.shape)
    dark = np.clip(noise, 0, 65535).astype(np.uint16)
    bright = np.minimum(good.astype(np.int64) * 8, 65535).astype(np.uint16)
    alone = _error(whites, lfcal.calibrate(good), basis, origin)
    for several in ([good, dark], [bright, good]):
        camera = lfcal.calibrate(several)
        assert camera.source == "white"
        assert _error(whites, camera, basis, origin) < 1.5 * alone + 0.0005


def test_among_scenes_only_the_white_image_is_used(house, house_white_camera):
    camera = lfcal.calibrate([house.flat, house.white])
    assert camera.source == "white"
    np.testing.assert_allclose(camera.lattice.basis, house_white_camera.lattice.basis, atol=1e-3)


def test_flats_of_different_sizes_are_refused_by_number(noisy):
    images, _, _ = noisy
    with pytest.raises(lfcal.FlatError, match=r"flat 2 is 399 x 320 px, flat 1 is 400 x 320 px"):
        lfcal.calibrate([images[0], images[1][:, 1:]])
    with pytest.raises(lfcal.FlatError, match=r"flat 2: has shape \(8,\)"):
        lfcal.calibrate([images[0], np.zeros(8)])
    stacked = np.stack([np.dstack([image] * 3) for image in images[:2]])
    assert lfcal.calibrate(stacked, kind="white").source == "white"


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (np.full((100, 100), np.nan), "NaN"),
        (np.where(np.eye(100) > 0, np.inf, 1.0), "infinite"),
        (np.zeros((10, 10)), "too small"),
        (np.zeros((50, 50, 5), np.uint8), "shape"),
        (np.zeros((0, 5)), "shape"),
        (np.ones((64, 64), complex), "type complex128"),
    ],
)
def test_array_that_cannot_be_a_flat_is_refused_with_the_reason(image, reason):
    with pytest.raises(lfcal.FlatError, match=reason):
        lfcal.calibrate(image)


@pytest.mark.parametrize(
    ("dtype", "largest", "level"),
    [
        (np.uint16, 900, 1023),
        (np.uint16, 4095, 4095),
        (np.uint16, 40000, None),
        (np.uint8, 200, None),
        (np.float32, 900, None),
    ],
)
def test_white_level_is_that_of_the_least_number_of_bits(dtype, largest, level):
    assert estimate_white_level([np.array([[0, largest]], dtype)]) == level


def test_overexposed_white_image_is_named_with_the_share_of_clipped_pixels(drawn, calibrated_white):
    truth = drawn("square", 24.3, 31.0, 34.0, size=(500, 400))
    light = truth.light() + truth.noise * np.random.default_rng(1).standard_normal((400, 500))
    image = np.rint(np.clip(2.2 * light, 0, 1) * 255).astype(np.uint8)
    camera = lfcal.calibrate(image, "white")
    assert any("over-exposed" in text for text in camera.warnings)
    assert not any("over-exposed" in text for text in calibrated_white[1].warnings)


def test_share_of_clipped_pixels_is_measured_at_the_limit_of_the_sensor():
    flat = np.full((10, 10), 100, np.uint16)
    flat[:3] = 4095
    flat[3] = 80  # masks have two tones
    assert measure_overexposure(flat) == 0.3
    assert measure_overexposure(flat.astype(np.float32)) == 0.0
    flat[:3] = 200
    assert measure_overexposure(flat) == 0.0
