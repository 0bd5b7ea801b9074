"""How much work a calibration on a white image takes, and that what saves it changes nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfcal
from benchmarks.calibration_speed import drawn
from benchmarks.white_images import WhiteImage
from lfcal.detection.first_lattice import find_first_lattice, find_first_lattices_at_half_size
from lfcal.images.preprocessing import sqrt_luminance
from lfcal.lattice.cell import cell_normals, cell_row_bounds, is_outside_cell, row_interval
from lfcal.lattice.lattice import Lattice
from lfcal.scene_fit.irls import LensShifts, solve_irls
from lfcal.white_fit import gauss_newton, normal_equations
from lfcal.white_fit.gauss_newton import StepResult
from lfcal.white_fit.model import CatEye, step_limits


@pytest.fixture(scope="module")
def white():
    truth = WhiteImage("hexagonal", 12.3, 4.0, 30.0, 8, size=(1400, 1000))
    return truth, drawn(truth, 1)


def test_all_lenses_are_compared_with_the_model_once(white, monkeypatch):
    truth, image = white
    compared = []
    original = normal_equations.build_normal_equations

    def counted(discs, learn=True):
        compared.append(len(discs.centres))
        return original(discs, learn)

    monkeypatch.setattr(normal_equations, "build_normal_equations", counted)
    monkeypatch.setattr(gauss_newton, "build_normal_equations", counted)
    camera = lfcal.calibrate(image)
    assert camera.lenses_used > 9000
    # A few hundred find the model, some thousand choose its orders, all of them tell the figures.
    assert sum(count > 9000 for count in compared) == 1
    assert sum(compared) < 2.5 * camera.lenses_used
    found = camera.lattice.centres()
    assert np.sqrt(((found - truth.centres(truth.index_of(found))) ** 2).sum(1).mean()) < 5e-4


def test_some_lenses_are_enough_where_they_are_cut(drawn, monkeypatch):
    truth = drawn("hexagonal", 12.3, 4.0, 26.0, 8, 0.3, size=(1400, 1000))
    compared = []
    original = normal_equations.build_normal_equations

    def counted(discs, learn=True):
        compared.append(len(discs.centres))
        return original(discs, learn)

    monkeypatch.setattr(normal_equations, "build_normal_equations", counted)
    camera = lfcal.calibrate(truth.image())
    found = camera.lattice.centres()
    assert np.sqrt(((found - truth.centres(truth.index_of(found))) ** 2).sum(1).mean()) < 0.01
    # The model of the cut is off by several times what chance leaves of a tenth of the lenses.
    assert max(compared) < 0.25 * len(found)
    assert len(compared) < 40


def test_step_is_held_back_where_least_squares_are_least_sure():
    names = ["origin", "origin", "growth", "radius", "growth2", "correlation"]
    eye = CatEye(np.zeros(2), np.array([1.0, 0.0, 0.0]), 5.0, 0.5)
    limits = step_limits(eye, names)
    assert np.isinf(limits[:2]).all()
    # Growth and radius are known together to a tenth of a pixel, their difference to a hundredth.
    mixing = np.eye(6)
    mixing[2:4, 2:4] = np.array([[1, 1], [1, -1]]) / np.sqrt(2)
    covariance = mixing @ np.diag([1e-6, 1e-6, 1e-2, 1e-4, 1e-4, 1e-2]) @ mixing.T
    change = np.array([0.3, -0.2, 2.0, 1.9, 0.01, 0.02])
    columns = np.zeros((3, 6, 6))
    columns[:, :2, :2] = np.eye(2)
    whole = StepResult(
        change, np.zeros(6), 1.0, 0.0, 0.0, 3, names, covariance, columns, None, *np.zeros((2, 3, 2)), np.ones(3)
    )
    held = gauss_newton._damp(whole, limits)
    assert np.abs(held.change / limits).max() <= 1
    assert held.change[2] > 0.25
    assert held.change[2] - held.change[3] == pytest.approx(0.1, abs=0.02)
    np.testing.assert_allclose(held.change[:2], change[:2])
    assert held.shift_rms == pytest.approx(np.hypot(0.3, 0.2))
    assert gauss_newton._damp(held, limits) is held
    # What is known for certain is held back too, and nothing else with it.
    certain = np.diag([1e-6, 1e-6, 1e-2, 1e-2, 1e-2, 0.0])
    change = np.array([0.3, -0.2, 0.1, 0.1, 0.01, -0.7])
    held = gauss_newton._damp(replace(whole, change=change, covariance=certain), limits)
    np.testing.assert_allclose(held.change[:5], change[:5], rtol=0.05)
    assert held.change[5] == -limits[5]


def test_step_of_a_known_profile_leaves_a_tenth_of_itself_at_most(white, monkeypatch):
    truth, image = white
    moves = []
    original = gauss_newton._solve_step

    def seen(state, *arguments, **options):
        summary = original(state, *arguments, **options)
        moves.append((len(state.indices), summary.shift_rms))
        return summary

    monkeypatch.setattr(gauss_newton, "_solve_step", seen)
    monkeypatch.setattr(gauss_newton, "_is_near", lambda step: False)
    start = Lattice(truth.origin + 0.05, truth.basis * 1.00003, truth.size, 5.0)
    from lfcal.white_fit.fit import fit_white

    fit_white(sqrt_luminance(image), start)
    # Of the first lenses the profile is still to be found.
    some = sorted({count for count, _ in moves})[1]
    first, second = [moved for count, moved in moves if count == some][:2]
    assert first > 2e-4
    assert second < 0.1 * first


@pytest.mark.parametrize(
    ("shape", "degrees"), [("hexagonal", 0.0), ("hexagonal", 17.0), ("square", 0.0), ("square", 40)]
)
def test_rows_of_a_cell_end_where_its_sides_are(shape, degrees):
    truth = WhiteImage(shape, 13.7, degrees, size=(200, 200))
    faces, reach = cell_normals(Lattice(truth.origin, truth.basis, truth.size, 6.0))
    sides = cell_row_bounds(faces)
    inside = 0
    for dy in np.arange(-reach - 1, reach + 1, 0.37):
        low, high = row_interval(dy, sides)
        for dx in np.arange(-reach - 1, reach + 1, 0.37):
            here = sides[6, 0] <= dy <= sides[6, 1] and low <= dx <= high
            assert here == (not is_outside_cell(dx, dy, faces))
            inside += here
    assert inside * 0.37**2 == pytest.approx(abs(np.linalg.det(truth.basis)), rel=0.03)


@pytest.mark.parametrize(("pitch", "half"), [(44.2, 2), (14.1, 1)])
def test_first_lattices_of_large_microimages_is_found_at_half_size(pitch, half):
    truth = WhiteImage("hexagonal", pitch, 7.0, 26.0, size=(701, 520))
    picture = sqrt_luminance(drawn(truth, 1))
    start = next(find_first_lattices_at_half_size(picture))
    assert start.brightness.shape == (520 // half, 701 // half)
    found = start.lattice.centres()
    assert start.lattice.image_size == truth.size
    assert np.sqrt(((found - truth.centres(truth.index_of(found))) ** 2).sum(1).mean()) < 0.02 * pitch
    if half == 1:
        np.testing.assert_array_equal(start.lattice.basis, find_first_lattice(picture).lattice.basis)


def test_lenses_that_agreed_before_are_asked_again():
    rng = np.random.default_rng(2)
    design = np.column_stack([np.ones(600), rng.integers(-20, 20, (600, 2))])
    step = rng.normal(0, 0.01, (600, 2))
    misled = np.arange(600) < 250
    step[misled] += 1.0
    steps = LensShifts(design, step, np.full(600, 1e-4), np.eye(2) * 20)
    assert np.abs(solve_irls(steps)[0][0]).max() < 0.01
    again, share = solve_irls(steps, before=misled.astype(float))
    np.testing.assert_allclose(again[0], [1.0, 1.0], atol=0.01)
    assert share[~misled].max() == 0


def test_lenses_in_one_place_are_no_division_by_zero():
    steps = LensShifts(np.ones((30, 3)), np.full((30, 2), 0.1), np.full(30, 1e-4), np.eye(2) * 20)
    change, _ = solve_irls(steps)
    assert change.shape == (3, 2)
