"""Gaps between microimages of any shape prove a lattice, and tell it from lattices that are too fine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import lfcal
from data_synth import SCENES, Camera, simulate
from lfcal.detection.gaps import measure_gaps, window_likelihood
from lfcal.images.preprocessing import normalise_locally, sqrt_luminance

_CAPTURES = Path(__file__).resolve().parents[4] / "shared" / "captures"
_PITCH = 31.0


@pytest.fixture(scope="module")
def square():
    """A scene through square apertures with dark gaps, and its true lattice."""
    camera = Camera.design((700, 520), _PITCH, "square", 4.0, microimage_fill=0.9).replace(square_aperture=True)
    flat = simulate(SCENES["clutter"](camera, seed=2), camera, samples=4, seed=2, noise=(8000.0, 4.0)).flat
    return flat, camera.lattice


def _brightness(flat):
    return normalise_locally(sqrt_luminance(flat), 2 * _PITCH)


def test_centres_and_gaps_of_square_apertures_are_measured(square):
    flat, lattice = square
    gaps = measure_gaps(_brightness(flat), lattice.basis, 150)
    away = (gaps.centre @ gaps.basis - lattice.origin) @ np.linalg.inv(lattice.basis)
    assert np.abs((away - np.rint(away)) @ lattice.basis).max() < 0.03 * _PITCH
    assert gaps.weakest > 0.3
    assert gaps.prove_lattice()


@pytest.mark.parametrize(
    "finer", [[(0.5, 0), (0, 1)], [(1, 0), (0, 0.5)], [(0.5, 0.5), (0.5, -0.5)], [(1 / 3, 0), (0, 1)]]
)
def test_lattice_too_fine_lacks_gaps(square, finer):
    flat, lattice = square
    assert measure_gaps(_brightness(flat), np.array(finer) @ lattice.basis, 150).weakest < 0.04


def test_right_period_is_more_likely_than_one_a_percent_beside(square):
    flat, lattice = square
    brightness = _brightness(flat)
    right = window_likelihood(brightness, lattice.basis, 150)
    assert all(window_likelihood(brightness, scale * lattice.basis, 150) < 0.9 * right for scale in (0.99, 1.01, 1.03))


def test_scene_through_square_apertures_is_calibrated():
    # A plane, whose detail is alike in all lenses and draws their edges after it by 2.5 px.
    camera = Camera.design((1130, 847), 47.1, "square", -20.0, microimage_fill=0.83).replace(square_aperture=True)
    flat = simulate(SCENES["plane"](camera, seed=5003), camera, samples=3, seed=5003, noise=(8000.0, 4.0)).flat
    found = lfcal.calibrate(flat)
    apart = found.lattice.to_index(camera.lattice.centres())
    assert np.abs((apart - np.rint(apart)) @ found.lattice.basis).max() < 0.1
    assert found.confidence > 0.9


def _capture(name):
    if not (_CAPTURES / name).exists():
        pytest.skip(f"{_CAPTURES / name} is not there")
    return lfcal.read_flat(_CAPTURES / name)


@pytest.mark.parametrize("part", [np.s_[:, :], np.s_[1459:, :785]])
def test_camera_of_the_2008_paper_is_found_whole_and_in_a_quarter(part):
    flat = _capture("Square.jpg")
    top, left = part[0].start or 0, part[1].start or 0
    found = lfcal.calibrate(np.ascontiguousarray(flat[part]))
    lattice = found.lattice
    assert abs(lattice.pitch - 74.69) < 0.1
    # Detail in the lower left quarter is the same, shifted, in too few neighbours.
    assert found.confidence > (0.35 if top else 0.9)
    centres = lattice.centres() + np.array([left, top])
    beside = [(centres[:, k] - line - period / 2) / period for k, line, period in ((0, 0.69, 74.692), (1, 70.7, 74.69))]
    off = [float(np.mean(one - np.rint(one))) * 74.69 for one in beside]
    assert np.abs(off).max() < (0.5 if flat[part].shape == flat.shape else 1.1)


def test_board_before_an_array_is_taken_for_a_scene():
    found = lfcal.calibrate(_capture("Board.tif"))
    assert (found.source, round(found.lattice.pitch, 1)) == ("scene", 25.4)


def test_white_image_of_small_spots_is_taken_for_what_it_is():
    found = lfcal.calibrate(_capture("Faint.white.tif"))
    assert found.source == "white"
    assert abs(found.lattice.pitch - 10.41) < 0.01 and found.confidence > 0.9


def test_stated_pitch_that_fits_two_lattices_is_refused():
    with pytest.raises(lfcal.CalibrationError, match="several lattices"):
        lfcal.calibrate(_capture("Letras.png"), pitch=21.0)
