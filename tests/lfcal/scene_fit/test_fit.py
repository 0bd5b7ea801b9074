"""The lattice of scenes: right where a part of the flat misleads, is black, or where the array is not regular."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numba
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

import lfcal
from lfcal.images.preprocessing import edge_strength, normalise_locally, sqrt_luminance
from lfcal.lattice.distortion import Distortion
from lfcal.lattice.lattice import Lattice
from lfcal.lattice.robust_fit import field_rms
from lfcal.scene_fit.fit import Acceleration, fit_scene, measure_shifts, move_lattice, select_lenses, standard_error
from lfcal.scene_fit.irls import LensShifts, _weighted_quantile, error_inflation, solve_irls


def _fit(image, basis, origin, off=0.4):
    """Fit to the breaks of an image, started `off` px beside the truth."""
    start = Lattice(origin + off, basis, (image.shape[1], image.shape[0]), 5.0)
    return fit_scene(normalise_locally(edge_strength(sqrt_luminance(image)), 0.5 * start.pitch), start)


def _rms(fit, basis, origin, size):
    truth = Lattice(origin, basis, size, 5.0)
    miss = fit.origin + truth.indices() @ fit.basis - truth.centres()
    return float(np.sqrt((miss**2).sum(1).mean()))


def test_centres_of_a_simulated_scene_are_within_a_fiftieth_pixel(house):
    truth = house.truth.calibration.lattice
    camera = lfcal.calibrate(house.flat)
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
    bend = Distortion((np.array([width, height]) - 1) / 2, 0.006, 0.0, float(np.hypot(width, height) / 2))
    y, x = np.mgrid[:height, :width].astype(np.float64)
    source = bend.remove(np.column_stack([x.ravel(), y.ravel()])).T[::-1].reshape(2, height, width)
    # Fifth-order splines: linear interpolation blurs some lenses more than others.
    bent = np.clip(np.rint(map_coordinates(grey, source, order=5, mode="reflect")), 0, 255).astype(np.uint8)
    camera = lfcal.calibrate(bent, "scene")
    centres = camera.lattice.centres()
    moved = replace(truth, distortion=bend)
    miss = centres - moved.points(np.rint(moved.to_index(centres)))
    # The best straight lattice is off by 0.23 px.
    assert np.sqrt((miss**2).sum(1).mean()) < 0.05
    assert camera.lattice.distortion.k1 == pytest.approx(0.006, abs=0.0006)


def test_repeated_calls_and_other_thread_counts_give_the_same_bits(house):
    found = []
    threads = numba.get_num_threads()
    for count in (threads, 1, threads):
        numba.set_num_threads(count)
        cv2.setNumThreads(count)
        camera = lfcal.calibrate(house.flat)
        found.append([*camera.lattice.origin, *camera.lattice.basis.ravel(), camera.confidence, camera.residual_rms])
    cv2.setNumThreads(-1)
    assert found[0] == found[1] == found[2]


def test_breaks_are_the_same_bits_wherever_a_picture_lies_in_memory():
    picture = np.random.default_rng(0).random((512, 509), dtype=np.float32) ** 4
    seen = set()
    kept = []
    for size in range(40):
        # Blocks of other sizes in between move the pictures about.
        kept.append(np.empty(16 * size + 8, np.uint8))
        space = np.empty(picture.size + 16, np.float32)
        copy = space[size % 16 : size % 16 + picture.size].reshape(picture.shape)
        copy[:] = picture
        seen.add(edge_strength(copy).tobytes())
    assert len(seen) == 1


def test_breaks_are_the_square_root_of_the_sobel_gradient():
    y, x = np.mgrid[:9, :12].astype(np.float32)
    steep = edge_strength(np.ascontiguousarray(0.3 * x + 0.4 * y))
    # A slope of 0.5 per pixel, weighted 8 times; at the border the picture is mirrored.
    assert np.allclose(steep[1:-1, 1:-1], 2.0, atol=1e-5)
    assert np.allclose(steep[0, 1:-1] ** 2, 2.4, atol=1e-5)
    assert np.allclose(steep[1:-1, 0] ** 2, 3.2, atol=1e-5)
    assert np.allclose(steep[[0, 0, -1, -1], [0, -1, 0, -1]], 0, atol=1e-5)


def test_a_dragged_part_of_the_flat_has_no_say(whites):
    basis = whites.turned(whites.HEXAGON, 14.3, 3)
    image, origin = whites.white_image(basis, (600, 500), noise=0.05)
    image[300:] = np.roll(image[300:], 1, axis=1)
    # Least squares through all of it would be off by half a pixel and more.
    assert _rms(_fit(image, basis, origin), basis, origin, (600, 500)) < 0.05


def test_lenses_whose_rims_drown_in_a_dragged_scene_have_no_say(whites):
    basis, size = whites.turned(whites.HEXAGON, 14.3, 3), (900, 750)
    image, origin = whites.white_image(basis, size, noise=0.3)
    dragged = cv2.warpAffine(image.astype(np.float32), np.float32([[1, 0, 0.7], [0, 1, 0]]), size)[490:]
    texture = cv2.GaussianBlur(np.random.default_rng(0).random(dragged.shape), (0, 0), 1.2)
    image[490:] = dragged * np.clip(1 + (texture - texture.mean()) / texture.std(), 0.1, None)
    # With all lenses the error is twice this.
    assert _rms(_fit(image, basis, origin, 0.3), basis, origin, size) < 0.01


def test_most_of_a_flat_dragged_along_with_its_texture_has_no_say(whites):
    basis, size = whites.turned(whites.HEXAGON, 14.3, 3), (900, 750)
    image, origin = whites.white_image(basis, size, noise=0.1)
    dragged = cv2.warpAffine(image.astype(np.float32), np.float32([[1, 0, 0.4], [0, 1, 0]]), size)[300:]
    texture = cv2.GaussianBlur(np.random.default_rng(0).random(dragged.shape), (0, 0), 1.2)
    image[300:] = dragged * np.clip(1 + 0.3 * (texture - texture.mean()) / texture.std(), 0.1, None)
    # Where each lens has the same say the error is 0.18 px.
    assert _rms(_fit(image, basis, origin, 0.3), basis, origin, size) < 0.01


def test_a_fit_whose_steps_fall_short_is_followed_to_its_end():
    lattice = Lattice(np.array([10.0, 12.0]), np.array([[20.0, 0.0], [10.0, 17.0]]), (400, 300), 10.0)
    design = np.column_stack([np.ones(len(lattice)), lattice.indices()])
    wanted = np.array([[0.3, -0.2], [0.02, -0.01], [0.005, 0.03]])
    # Scale is followed by a fifth of what is left, the origin at once.
    share = np.array([[1.0], [0.2], [0.3]])
    path, now = Acceleration([], []), lattice
    for _ in range(8):
        left = wanted - np.vstack([now.origin - lattice.origin, now.basis - lattice.basis])
        now = move_lattice(now, path.leap(now, share * left, design))
    miss = design @ (wanted - np.vstack([now.origin - lattice.origin, now.basis - lattice.basis]))
    # Steps as they are asked for would leave a sixth of it, 0.04 px.
    assert np.sqrt((miss**2).sum(1).mean()) < 0.001


def test_the_standard_error_of_a_flat_with_a_dragged_part_is_not_that_of_independent_lenses(whites):
    basis, size = whites.turned(whites.HEXAGON, 14.3, 3), (600, 500)
    image, origin = whites.white_image(basis, size, noise=0.05)
    whole = _fit(image, basis, origin).uncertainty
    image[300:] = cv2.warpAffine(image.astype(np.float32), np.float32([[1, 0, 0.1], [0, 1, 0]]), size)[300:]
    fit = _fit(image, basis, origin)
    miss = _rms(fit, basis, origin, size)
    assert miss > 0.01
    assert fit.uncertainty > 4 * whole
    assert miss < 5 * fit.uncertainty


def test_a_black_part_of_the_flat_does_not_hold_the_lattice_where_it_starts(whites):
    basis = whites.turned(whites.HEXAGON, 14.3, 3)
    image, origin = whites.white_image(basis, (600, 500), noise=0.02)
    image[:, 420:] = 0
    assert _rms(_fit(image, basis, origin), basis, origin, (600, 500)) < 0.05


@pytest.mark.parametrize("stretch", [1.0, 1.002])
def test_an_array_is_taken_as_regular_only_where_it_is(whites, stretch):
    basis = whites.turned(whites.HEXAGON, 14.3, 3) * [1.0, stretch]
    image, origin = whites.white_image(basis, (600, 500))
    fit = _fit(image, basis, origin)
    a1, a2 = fit.basis @ [1, 1j]
    assert (abs(a2 / a1 - np.exp(1j * np.pi / 3)) < 1e-9) == (stretch == 1.0)
    assert _rms(fit, basis, origin, (600, 500)) < 0.01


def test_square_lattice_of_70_px_is_fitted_on_every_third_pixel(whites):
    basis = whites.turned(whites.SQUARE, 70.0, 1)
    image, origin = whites.white_image(basis, (1000, 800))
    assert _rms(_fit(image, basis, origin, 0.5), basis, origin, (1000, 800)) < 0.03


def test_lenses_that_a_step_moves_over_the_edge_of_the_flat_say_nothing(whites):
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


def test_one_lens_far_surer_than_all_others_moves_the_lattice_and_leaves_its_basis():
    """As on a photograph of one clear spot; sums of squares about a single place underflow."""
    i, j = np.arange(12) % 4, np.arange(12) // 4
    step = np.random.default_rng(1).normal(size=(12, 2))
    variance = np.where(i + j == 0, 1e-60, 1e60)
    steps = LensShifts(np.column_stack([np.ones(12), i, j]), step, variance, 20 * np.eye(2))
    change, weight = solve_irls(steps)
    np.testing.assert_allclose(change, [step[0], [0, 0], [0, 0]], atol=1e-12)
    assert (weight[1:] == 0).all() and weight[0] > 0


def test_standard_error_of_agreeing_lenses_is_the_spread_of_what_they_agree_on():
    """Weights that follow from the steps tell less than fixed ones would: a third of the error was missing."""
    j, i = np.mgrid[-10:11, -12:13]
    design = np.column_stack([np.ones(i.size), i.ravel(), j.ravel()]).astype(float)
    rng = np.random.default_rng(3)
    stated, found = [], []
    for _ in range(60):
        variance = rng.uniform(0.5, 2.0, len(design))
        step = rng.normal(0, 0.1, (len(design), 2)) * np.sqrt(variance)[:, None]
        steps = LensShifts(design, step, variance, 14.0 * np.eye(2))
        change, share = solve_irls(steps)
        stated.append(standard_error(steps, change, share) * error_inflation(steps, share))
        found.append(field_rms(steps.design, change))
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(np.sqrt(np.mean(np.square(stated))), rel=0.15)


@pytest.mark.parametrize("count", [1, 2, 3, 10, 500])
def test_weighted_quantile_is_that_of_the_sorted_values(count):
    rng = np.random.default_rng(count)
    for values in (rng.random(count), rng.integers(0, 4, count).astype(float)):
        weight = rng.random(count) * (rng.random(count) < 0.7) + 1e-9
        order = np.argsort(values)
        below = np.cumsum(weight[order])
        for share in (0.05, 0.5, 0.95):
            wanted = share * weight.sum()
            value = values[order][np.searchsorted(below, wanted)]
            for about in (0.0, 0.9 * value, value, 2.0):
                assert _weighted_quantile(values, weight, wanted, about, np.empty(count), np.empty(count)) == value
