"""Work of a calibration on a white image, and steps of its fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfcal
from benchmarks.calibration_speed import drawn
from benchmarks.white_images import WhiteImage
from lfcal.images.preprocessing import sqrt_luminance
from lfcal.lattice.lattice import Lattice
from lfcal.white_fit import gauss_newton, normal_equations
from lfcal.white_fit.gauss_newton import StepResult
from lfcal.white_fit.model import CatEye, step_limits


@pytest.fixture(scope="module")
def white():
    truth = WhiteImage("hexagonal", 12.3, 4.0, 30.0, 8, size=(1400, 1000))
    return truth, drawn(truth, 1)


def test_all_lenses_are_evaluated_once(white, monkeypatch):
    truth, image = white
    evaluated = []
    original = normal_equations.build_normal_equations

    def counted(discs, learn=True):
        evaluated.append(len(discs.centres))
        return original(discs, learn)

    monkeypatch.setattr(normal_equations, "build_normal_equations", counted)
    monkeypatch.setattr(gauss_newton, "build_normal_equations", counted)
    camera = lfcal.calibrate(image)
    assert camera.lenses_used > 9000
    # Few hundred find the model, some thousand select its parameters, all of them give the final values.
    assert sum(count > 9000 for count in evaluated) == 1
    assert sum(evaluated) < 2.5 * camera.lenses_used
    found = camera.lattice.centres()
    assert np.sqrt(((found - truth.centres(truth.index_of(found))) ** 2).sum(1).mean()) < 5e-4


def test_a_quarter_of_the_lenses_is_enough_if_they_are_cut(drawn, monkeypatch):
    truth = drawn("hexagonal", 12.3, 4.0, 26.0, 8, 0.3, size=(1400, 1000))
    evaluated = []
    original = normal_equations.build_normal_equations

    def counted(discs, learn=True):
        evaluated.append(len(discs.centres))
        return original(discs, learn)

    monkeypatch.setattr(normal_equations, "build_normal_equations", counted)
    camera = lfcal.calibrate(truth.image())
    found = camera.lattice.centres()
    assert np.sqrt(((found - truth.centres(truth.index_of(found))) ** 2).sum(1).mean()) < 0.01
    # The model of the cut is off by several times the random error of a tenth of the lenses.
    assert max(evaluated) < 0.25 * len(found)
    assert len(evaluated) < 40


def test_step_is_damped_along_its_least_certain_directions():
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
    # A parameter without variance is limited too, and nothing else with it.
    certain = np.diag([1e-6, 1e-6, 1e-2, 1e-2, 1e-2, 0.0])
    change = np.array([0.3, -0.2, 0.1, 0.1, 0.01, -0.7])
    held = gauss_newton._damp(replace(whole, change=change, covariance=certain), limits)
    np.testing.assert_allclose(held.change[:5], change[:5], rtol=0.05)
    assert held.change[5] == -limits[5]


def test_second_step_with_a_known_profile_is_a_tenth_of_the_first_at_most(white, monkeypatch):
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
    # The first lenses do not have a fitted profile yet.
    some = sorted({count for count, _ in moves})[1]
    first, second = [moved for count, moved in moves if count == some][:2]
    assert first > 2e-4
    assert second < 0.1 * first
