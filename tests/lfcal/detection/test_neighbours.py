"""How well neighbouring microimages match."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import lfcal
from lfcal.detection.neighbours import compare_neighbours, measure_likeness

_SIZE = (720, 600)
_PITCH = 24.0


def _lattice(down: float) -> lfcal.Lattice:
    """Cells of 24 x `down` px: neighbours across only are compared if they are much longer."""
    basis = [[_PITCH, 0], [0, down]]
    return lfcal.Lattice(np.array([12.0, 12.0]), basis, _SIZE, 11.0)


def _scene(lattice: lfcal.Lattice, disparity: float) -> np.ndarray:
    """A flat of random blots that all lenses show at one disparity [pitch]."""
    rng = np.random.default_rng(1)
    plane = cv2.GaussianBlur(rng.normal(0, 1, (1400, 1600)), (0, 0), 4.0) * 8 + 5
    y, x = np.indices(_SIZE[::-1]).astype(float)
    places = np.column_stack([x.ravel(), y.ravel()])
    centres = lattice.points(np.rint(lattice.to_index(places)))
    seen = centres - (places - centres) / disparity + 400
    across, down = seen.astype(np.float32).reshape(*_SIZE[::-1], 2).transpose(2, 0, 1)
    shown = cv2.remap(plane, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.maximum(shown, 0.5).astype(np.float32)


@pytest.mark.parametrize("down", [24.0, 36.0])
@pytest.mark.parametrize("disparity", [-0.3, 0.45])
def test_neighbours_match_at_the_shift_that_all_lenses_name(down, disparity):
    lattice = _lattice(down)
    found = measure_likeness(_scene(lattice, disparity), lattice)
    assert found.parallax > 1.0 > found.still


@pytest.mark.parametrize(("down", "most"), [(24.0, 0.1), (36.0, 0.35)])
def test_cells_of_their_own_content_do_not_match_by_chance(down, most):
    """In a single direction, the best shift of each lens would be chance (0.7)."""
    rng = np.random.default_rng(0)
    flat = cv2.GaussianBlur(rng.normal(0, 1, _SIZE[::-1]), (0, 0), 3.0) * 6 + 5
    assert measure_likeness(flat.astype(np.float32), _lattice(down)).parallax < most


@pytest.mark.parametrize("down", [24.0, 36.0])
def test_differences_that_fall_to_the_farthest_shift_prove_no_parallax(down):
    lattice = _lattice(down)
    assert measure_likeness(_scene(lattice, 0.75), lattice).parallax == 0


_ROW = lfcal.Lattice((12, 20), ((_PITCH, 0), (0, 2 * _PITCH)), (480, 40), 11)
_RATIOS = np.linspace(-0.6, 0.6, 25)


def _row_of_lenses(ratio):
    """A row of microimages of a plane at `ratio` [s / D], as in GEOMETRY.md."""
    rng = np.random.default_rng(2)
    places = np.arange(4000)
    x = np.broadcast_to(np.arange(480), (40, 480))
    lens = np.floor(x / _PITCH) + 0.5
    # A lens shows the place `centre - away / ratio`.
    seen = 2000 + 5 * (lens - (x / _PITCH - lens) / ratio)
    rows = [np.interp(row, places, rng.random(4000) + 0.2) for row in seen]
    return np.array(rows, np.float32)


@pytest.mark.parametrize("ratio", [-0.35, 0.25])
def test_neighbours_differ_least_at_the_disparity_of_the_scene(ratio):
    centres = np.column_stack([(np.arange(2, 17) + 0.5) * _PITCH - 0.5, np.full(15, 20.0)])
    difference, contrast = compare_neighbours(_row_of_lenses(ratio), _ROW, centres, 10.0, _RATIOS)
    alike = (difference / contrast).mean(1)
    assert _RATIOS[alike.argmin()] == pytest.approx(ratio, abs=0.026)
    assert alike.min() < 0.5 * np.median(alike)


def test_neighbours_beyond_the_border_do_not_count():
    centres = np.array([[36.0, 20.0], [468.0, 20.0]])
    compared = compare_neighbours(_row_of_lenses(0.25), _ROW, centres, 10.0, _RATIOS)
    assert (compared[1, :, 0] > 0).all()
    assert (compared[:, :, 1] == 0).all()
