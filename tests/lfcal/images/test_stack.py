"""Several flats of one camera: their combination is better than each; useless flats are left out."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal

_SIZE = (500, 400)


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
    single = [_error(whites, lfcal.calibrate(image, kind="white"), basis, origin) for image in images]
    together = lfcal.calibrate(images, kind="white")
    assert _error(whites, together, basis, origin) < 0.75 * np.sqrt(np.mean(np.square(single)))


@pytest.mark.parametrize("useless", ["dark", "saturated", "eight times as bright"])
def test_a_useless_flat_does_not_change_the_centres_of_a_good_one(whites, useless):
    basis = whites.turned(whites.HEXAGON, 14.3, 3)
    good, origin = whites.white_image(basis, _SIZE)
    noise = np.random.default_rng(1).normal(600, 400, good.shape)
    other = {
        "dark": np.clip(noise, 0, 65535).astype(np.uint16),
        "saturated": np.full_like(good, 65535),
        "eight times as bright": np.minimum(good.astype(np.int64) * 8, 65535).astype(np.uint16),
    }[useless]
    alone = _error(whites, lfcal.calibrate(good), basis, origin)
    for pair in ([good, other], [other, good]):
        camera = lfcal.calibrate(pair)
        assert camera.source == "white"
        assert _error(whites, camera, basis, origin) < 1.5 * alone + 0.0005


def test_a_stack_and_a_list_of_flats_are_the_same(whites, noisy):
    images, _, _ = noisy
    listed = lfcal.calibrate(images[:2], kind="white").lattice
    stacked = lfcal.calibrate(np.stack([np.dstack([i] * 3) for i in images[:2]]), kind="white").lattice
    np.testing.assert_allclose(stacked.centres(), listed.centres(), atol=0.002)


def test_among_scenes_only_the_white_image_is_used(house):
    camera = lfcal.calibrate([house.flat, house.white])
    assert camera.source == "white"
    np.testing.assert_allclose(camera.lattice.basis, lfcal.calibrate(house.white).lattice.basis, atol=1e-3)


def test_flats_of_different_sizes_are_refused_by_number(noisy):
    images, _, _ = noisy
    with pytest.raises(lfcal.FlatError, match=r"flat 2 is 499 x 400 px, flat 1 is 500 x 400 px"):
        lfcal.calibrate([images[0], images[1][:, 1:]])
    with pytest.raises(lfcal.FlatError, match=r"flat 2 has shape \(8,\)"):
        lfcal.calibrate([images[0], np.zeros(8)])
