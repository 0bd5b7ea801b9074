"""Lattice of scenes: robust to dragged or black parts of the flat, for regular and irregular
arrays.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

import lfcal
from lfcal.images.preprocessing import edge_strength, normalise_locally, sqrt_luminance
from lfcal.lattice.distortion import Distortion
from lfcal.lattice.lattice import Lattice
from lfcal.scene_fit.fit import Acceleration, fit_scene, measure_shifts, select_lenses


def _fit(image, basis, origin, off=0.4):
    """Fit to the edges of an image, started `off` px beside the truth."""
    start = Lattice(origin + off, basis, (image.shape[1], image.shape[0]), 5.0)
    return fit_scene(
        normalise_locally(edge_strength(sqrt_luminance(image)), 0.5 * start.pitch), start
    )


def _rms(fit, basis, origin, size):
    truth = Lattice(origin, basis, size, 5.0)
    miss = fit.lattice.origin + truth.indices() @ fit.lattice.basis - truth.centres()
    return float(np.sqrt((miss**2).sum(1).mean()))


def _error(fit):
    """Standard error of a centre, RMS over the flat [px]."""
    return float(np.sqrt((fit.errors.of_centres(fit.lattice) ** 2).mean()))


def test_centres_of_a_simulated_scene_are_within_a_fiftieth_pixel(house, house_camera):
    truth = house.truth.calibration.lattice
    camera = house_camera
    centres = camera.lattice.centres()
    miss = centres - truth.points(np.rint(truth.to_index(centres)))
    assert camera.source == "scene"
    assert np.sqrt((miss**2).sum(1).mean()) < 0.02


def test_radial_distortion_of_a_simulated_scene_is_found_and_none_where_there_is_none(house):
    truth = house.truth.calibration.lattice
    straight = lfcal.calibrate(house.flat, "scene")
    assert straight.lattice.distortion is None
    grey = house.flat.astype(np.float64).mean(-1)
    height, width = grey.shape
    bend = Distortion(
        (np.array([width, height]) - 1) / 2, 0.006, 0.0, float(np.hypot(width, height) / 2)
    )
    y, x = np.mgrid[:height, :width].astype(np.float64)
    source = bend.remove(np.column_stack([x.ravel(), y.ravel()])).T[::-1].reshape(2, height, width)
    # Fifth-order splines: linear interpolation blurs some lenses more than others.
    bent = np.clip(np.rint(map_coordinates(grey, source, order=5, mode="reflect")), 0, 255).astype(
        np.uint8
    )
    camera = lfcal.calibrate(bent, "scene")
    centres = camera.lattice.centres()
    moved = replace(truth, distortion=bend)
    miss = centres - moved.points(np.rint(moved.to_index(centres)))
    # The best straight lattice is off by 0.23 px.
    assert np.sqrt((miss**2).sum(1).mean()) < 0.05
    assert camera.lattice.distortion.k1 == pytest.approx(0.006, abs=0.0006)


def test_a_dragged_part_of_the_flat_has_no_influence(whites):
    basis = whites.turned(whites.HEXAGON, 14.3, 3)
    image, origin = whites.white_image(basis, (600, 500), noise=0.05)
    image[300:] = np.roll(image[300:], 1, axis=1)
    # Least squares through all of it would be off by half a pixel and more.
    assert _rms(_fit(image, basis, origin), basis, origin, (600, 500)) < 0.05


def test_lenses_with_rims_hidden_by_a_dragged_scene_have_no_influence(whites):
    basis = whites.turned(whites.HEXAGON, 14.3, 3)
    size = (900, 750)
    image, origin = whites.white_image(basis, size, noise=0.3)
    dragged = cv2.warpAffine(image.astype(np.float32), np.float32([[1, 0, 0.7], [0, 1, 0]]), size)[
        490:
    ]
    texture = cv2.GaussianBlur(np.random.default_rng(0).random(dragged.shape), (0, 0), 1.2)
    image[490:] = dragged * np.clip(1 + (texture - texture.mean()) / texture.std(), 0.1, None)
    # With all lenses the error is twice this.
    assert _rms(_fit(image, basis, origin, 0.3), basis, origin, size) < 0.01


def test_most_of_a_flat_dragged_along_with_its_texture_has_no_influence(whites):
    basis = whites.turned(whites.HEXAGON, 14.3, 3)
    size = (900, 750)
    image, origin = whites.white_image(basis, size, noise=0.1)
    dragged = cv2.warpAffine(image.astype(np.float32), np.float32([[1, 0, 0.4], [0, 1, 0]]), size)[
        300:
    ]
    texture = cv2.GaussianBlur(np.random.default_rng(0).random(dragged.shape), (0, 0), 1.2)
    image[300:] = dragged * np.clip(1 + 0.3 * (texture - texture.mean()) / texture.std(), 0.1, None)
    # With equal weights of the lenses the error is 0.18 px.
    assert _rms(_fit(image, basis, origin, 0.3), basis, origin, size) < 0.01


def test_acceleration_converges_although_single_steps_fall_short():
    lattice = Lattice(
        np.array([10.0, 12.0]), np.array([[20.0, 0.0], [10.0, 17.0]]), (400, 300), 10.0
    )
    design = np.column_stack([np.ones(len(lattice)), lattice.indices()])
    wanted = np.array([[0.3, -0.2], [0.02, -0.01], [0.005, 0.03]])
    # A step corrects a fifth of the scale, and the origin at once.
    share = np.array([[1.0], [0.2], [0.3]])
    path = Acceleration([], [])
    now = lattice
    for _ in range(8):
        left = wanted - np.vstack([now.origin - lattice.origin, now.basis - lattice.basis])
        now = now.moved(path.leap(now, share * left, design).ravel())
    miss = design @ (wanted - np.vstack([now.origin - lattice.origin, now.basis - lattice.basis]))
    # Without acceleration a sixth of it would be left, 0.04 px.
    assert np.sqrt((miss**2).sum(1).mean()) < 0.001


def test_standard_error_of_a_flat_with_a_dragged_part_exceeds_that_of_independent_lenses(whites):
    basis = whites.turned(whites.HEXAGON, 14.3, 3)
    size = (600, 500)
    image, origin = whites.white_image(basis, size, noise=0.05)
    whole = _error(_fit(image, basis, origin))
    image[300:] = cv2.warpAffine(
        image.astype(np.float32), np.float32([[1, 0, 0.1], [0, 1, 0]]), size
    )[300:]
    fit = _fit(image, basis, origin)
    miss = _rms(fit, basis, origin, size)
    assert miss > 0.01
    assert _error(fit) > 4 * whole
    assert miss < 5 * _error(fit)


def test_a_black_part_of_the_flat_does_not_stop_the_fit(whites):
    basis = whites.turned(whites.HEXAGON, 14.3, 3)
    image, origin = whites.white_image(basis, (600, 500), noise=0.02)
    image[:, 420:] = 0
    assert _rms(_fit(image, basis, origin), basis, origin, (600, 500)) < 0.05


@pytest.mark.parametrize("stretch", [1.0, 1.002])
def test_an_array_is_taken_as_regular_only_where_it_is(whites, stretch):
    basis = whites.turned(whites.HEXAGON, 14.3, 3) * [1.0, stretch]
    image, origin = whites.white_image(basis, (600, 500))
    fit = _fit(image, basis, origin)
    a1, a2 = fit.lattice.basis @ [1, 1j]
    assert (abs(a2 / a1 - np.exp(1j * np.pi / 3)) < 1e-9) == (stretch == 1.0)
    assert _rms(fit, basis, origin, (600, 500)) < 0.01


def test_square_lattice_of_70_px_is_fitted_on_every_third_pixel(whites):
    basis = whites.turned(whites.SQUARE, 70.0, 1)
    image, origin = whites.white_image(basis, (1000, 800))
    assert _rms(_fit(image, basis, origin, 0.5), basis, origin, (1000, 800)) < 0.03


def test_lenses_moved_over_the_edge_of_the_flat_are_ignored(whites):
    basis = whites.turned(whites.HEXAGON, 20.3, 3)
    image, origin = whites.white_image(basis, (300, 260))
    lattice = lfcal.Lattice(origin, basis, (300, 260), 10.0)
    indices = select_lenses(lattice, 1000)
    moved = lfcal.Lattice(origin + np.array([60.0, 0.0]), basis, (300, 260), 10.0)
    variance = measure_shifts(image.astype(np.float32), moved, indices, 1).variance
    over = moved.points(indices)[:, 0] > 299
    assert over.sum() > 10
    assert np.isinf(variance[over]).all()
    assert np.isfinite(variance[~over]).any()


def test_microscope_capture_gives_the_lattice_of_its_white_image(shared):
    scene, white = (
        lfcal.read_flat(shared("captures", f"Beads{end}.tif"))[200:900, 300:1200]
        for end in ("", ".white")
    )
    found = lfcal.calibrate(scene).lattice
    right = lfcal.calibrate(white, kind="white").lattice
    away = right.to_index(found.centres())
    away = (away - np.rint(away)) @ right.basis
    assert np.sqrt((away**2).sum(1).mean()) < 0.5  # [px]


def test_part_of_a_microscope_capture_is_a_scene_whose_pixels_no_gain_map_explains(shared):
    scene = lfcal.read_flat(shared("captures", "GUV.tif"))
    assert lfcal.calibrate(scene[:145, :145]).source == "scene"
    # A stated pitch needs no proof; that does not make it a white image.
    assert lfcal.calibrate(scene, pitch=15.0).source == "scene"
