"""Residuals of single microimages against the lattice fitted to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfcal
from lfcal.lattice.residuals import Residuals

_SIZE = (700, 500)


@pytest.fixture(scope="module")
def displaced(whites):
    """A white image, four lenses of which are displaced by 0.3 px to the right, its camera, and their indices."""
    basis = whites.turned(whites.HEXAGON, 20.3, 3)
    image, origin = whites.white_image(basis, _SIZE, origin=(350.2, 250.4))
    shifted, _ = whites.white_image(basis, _SIZE, origin=(350.5, 250.4))
    moved = np.array([[0, 0], [1, 0], [-4, 5], [6, -3]])
    y, x = np.mgrid[0 : _SIZE[1], 0 : _SIZE[0]]
    for centre in origin + moved @ basis:
        near = np.hypot(x - centre[0], y - centre[1]) < 10
        image[near] = shifted[near]
    return image, lfcal.calibrate(image, "white"), origin + moved @ basis


def test_displaced_single_microimages_have_residuals(displaced):
    _, camera, places = displaced
    residuals = camera.residuals
    centres = camera.lattice.points(residuals.indices)
    out = np.hypot(*(centres[:, None] - places).transpose(2, 0, 1)).min(1) < 1
    assert out.sum() == 4
    np.testing.assert_allclose(residuals.offset[out], [[0.3, 0]] * 4, atol=0.06)
    assert np.hypot(*residuals.offset[~out].T).max() < 0.15


def test_means_over_the_flat_leave_outliers_out_and_have_standard_errors(displaced):
    _, camera, _ = displaced
    places, mean, error = camera.residuals.mean_over_grid(camera.lattice, 4, 3)
    assert len(places) == 12 and (np.hypot(*mean.T) < 4 * error).all() and (error < 0.02).all()


def test_residuals_in_the_camera_file_keep_a_thousandth_of_a_pixel(displaced, tmp_path):
    _, camera, _ = displaced
    camera.save(tmp_path / "camera.json")
    again = lfcal.load(tmp_path / "camera.json").residuals
    np.testing.assert_array_equal(again.indices, camera.residuals.indices)
    np.testing.assert_allclose(again.offset, camera.residuals.offset, atol=6e-4)


def test_systematic_residuals_are_drawn_as_arrows(displaced):
    image, camera, _ = displaced
    indices = camera.residuals.indices
    rng = np.random.default_rng(0)
    noise = 0.01 * rng.standard_normal(indices.shape).astype(np.float32)
    bent = noise + 0.1 * np.sign(indices[:, :1]).astype(np.float32)
    pictures = [lfcal.show(replace(camera, residuals=Residuals(indices, offset)), image) for offset in (noise, bent)]
    assert (pictures[0] != pictures[1]).mean() > 1e-4


def test_rows_of_different_length_are_refused():
    with pytest.raises(ValueError, match="two arrays"):
        Residuals(np.zeros((3, 2), np.int32), np.zeros((2, 2), np.float32))
