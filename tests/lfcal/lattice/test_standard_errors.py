"""Standard errors of a lattice, and residuals of single microimages against it."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

import lfcal
from lfcal.camera.plotting import plot_residuals
from lfcal.lattice.standard_errors import LatticeErrors, Residuals, equal_weight_errors


def test_camera_file_keeps_the_standard_errors(tmp_path):
    lattice = lfcal.Lattice([10.0, 9.0], [[14.3, 0.2], [6.9, 12.4]], (300, 200), 6.0)
    camera = lfcal.Calibration(lattice, errors=equal_weight_errors(lattice, 0.02))
    camera.save(tmp_path / "camera.json")
    kept = lfcal.load(tmp_path / "camera.json").errors.of_centres(lattice)
    np.testing.assert_allclose(np.sqrt((kept**2).mean()), 0.02, rtol=1e-9)
    middle = lattice.centres() - [150, 100]
    corner = np.hypot(150, 100)
    assert (
        kept[np.hypot(*middle.T) < 20].max() < 0.7 * kept[np.hypot(*middle.T) > 0.85 * corner].min()
    )


def test_the_condition_of_a_fit_is_larger_for_strips_and_independent_of_the_unit():
    def condition(size, origin):
        return equal_weight_errors(
            lfcal.Lattice(origin, [[10.0, 0.0], [0.0, 10.0]], size, 4.0), 0.02
        ).condition

    assert 1 <= condition((300, 300), (150.0, 150.0)) < 1.2
    # With the origin in a corner, origin and basis are correlated.
    assert 4 < condition((300, 300), (5.0, 5.0)) < 6
    assert condition((900, 20), (455.0, 5.0)) > 2
    errors = equal_weight_errors(
        lfcal.Lattice((5.0, 5.0), [[10.0, 0.0], [0.0, 10.0]], (300, 300), 4.0), 0.02
    )
    assert errors.scaled(8.0).condition == pytest.approx(errors.condition)
    # All parameters are fully correlated.
    assert LatticeErrors(errors.names, np.full((6, 6), 1e-6)).condition > 1e6


_SIZE = (700, 500)


@pytest.fixture(scope="module")
def displaced(whites):
    """A white image, four lenses of which are displaced by 0.3 px to the right, its camera, and
    their indices.
    """
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
    camera = displaced[1]
    indices = camera.residuals.indices
    rng = np.random.default_rng(0)
    noise = 0.01 * rng.standard_normal(indices.shape).astype(np.float32)
    bent = noise + 0.1 * np.sign(indices[:, :1]).astype(np.float32)
    axes = Figure().subplots()
    found = [
        plot_residuals(camera.lattice, Residuals(indices, offset), axes) for offset in (noise, bent)
    ]
    assert found[0][1] < 0.05 < found[1][1] and len(found[1][0].U) > 90


def test_rows_of_different_length_are_refused():
    with pytest.raises(ValueError, match="two arrays"):
        Residuals(np.zeros((3, 2), np.int32), np.zeros((2, 2), np.float32))
