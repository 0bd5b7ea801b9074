"""The final fit of a candidate counts by how far it has moved; noisy white images are found."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from benchmarks.no_flats import draw_no_flat
from lfcal import lattice_search


def test_lattices_that_no_fit_makes_likely_are_refused_without_one(monkeypatch):
    fitted = []
    monkeypatch.setattr(lattice_search, "_fit", lambda *_: fitted.append(1))
    with pytest.raises(lfcal.CalibrationError, match="a pattern repeats every"):
        lfcal.calibrate(draw_no_flat(300)[1])
    assert not fitted


def test_final_fit_that_runs_away_is_not_taken(shared):
    flat = lfcal.read_flat(shared("captures", "MiniGarden2.webp"))
    whole = lfcal.calibrate(flat).lattice
    height, width = flat.shape[:2]
    left = (width - 1400) // 2
    top = (height - 1120) // 2
    part = lfcal.calibrate(np.ascontiguousarray(flat[top : top + 1120, left : left + 1400])).lattice
    index = whole.to_index(part.centres() + np.array([left, top]))
    away = np.linalg.norm((index - np.rint(index)) @ whole.basis, axis=1)
    assert np.sqrt((away**2).mean()) < 0.05 * whole.pitch


def test_unevenly_stretched_array_whose_fits_disagree_is_not_stated(shared):
    """Its middle gives 51.75 px across, its edges 51.15 px; a crop has the right 50.9 px."""
    flat = lfcal.read_flat(shared("captures", "hard", "board_large_tiles.png"))
    with pytest.raises(lfcal.CalibrationError, match=r"every 51\.\d px"):
        lfcal.calibrate(flat)


def test_noisy_white_image_of_small_blurred_lenses_is_found(whites):
    basis = whites.turned(whites.HEXAGON, 10.0, 10)
    image, origin = whites.white_image(basis, (480, 400), fill=0.65, soft=5.0, gap=0.15, noise=0.03)
    camera = lfcal.calibrate(image)
    index = camera.lattice.to_index(origin[None])
    away = (index - np.rint(index)) @ camera.lattice.basis
    assert camera.confidence > 0.9
    assert abs(camera.lattice.pitch - 10.0) < 0.01
    assert np.linalg.norm(away) < 0.1


def test_noisy_white_image_without_detail_is_found_if_its_kind_is_stated(whites):
    basis = whites.turned(whites.SQUARE, 15.93, -4.5)
    image, _ = whites.white_image(
        basis, (446, 350), fill=0.64, soft=7.15, gap=0.254, noise=0.143, seed=22
    )
    with pytest.raises(lfcal.CalibrationError):
        lfcal.calibrate(image)
    camera = lfcal.calibrate(image, kind="white")
    assert camera.confidence > 0.9
    assert abs(camera.lattice.pitch - 15.93) < 0.01


def test_print_that_is_stated_to_be_a_white_image_is_refused():
    """Its dots scatter light in some cells far more than in others, as no noise does."""
    with pytest.raises(lfcal.CalibrationError):
        lfcal.calibrate(draw_no_flat(7520)[1], kind="white")
