"""Lattices that are stated, as a hint or as a whole."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from lfcal.lattice.lattice import describe_orientation
from lfcal.lattice.stated import ARRANGEMENTS, LatticeHint, state_lattice


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_stated_lattice_has_the_figures_given(arrangement):
    lattice = state_lattice((400, 300), 20.5, arrangement, 1.5, (100.0, 90.0), 9.0)
    shape, rows, rotation = describe_orientation(lattice)
    assert (
        lattice.pitch == pytest.approx(20.5)
        and rotation == pytest.approx(1.5)
        and lattice.radius == 9.0
    )
    assert shape == arrangement.split("-")[0] and (rows == "vertical") == arrangement.endswith(
        "vertical"
    )
    index = lattice.to_index([[100.0, 90.0]])
    np.testing.assert_allclose(index, np.rint(index), atol=1e-9)


def test_hint_allows_its_pitch_and_rotation_alone():
    hint = LatticeHint(20.0, 1.0)
    assert hint.allows(state_lattice((400, 300), 20.9, "square", 2.0))
    assert not hint.allows(state_lattice((400, 300), 23.0, "square", 1.0))
    assert not hint.allows(state_lattice((400, 300), 20.0, "square", 8.0))
    assert LatticeHint(20.0).allows(state_lattice((400, 300), 20.0, "hexagonal", 8.0))
    with pytest.raises(ValueError, match="pitch"):
        LatticeHint(-1.0)


def test_hint_leads_to_the_lattice_and_a_wrong_one_is_refused(whites):
    image, _ = whites.white_image(whites.turned(whites.SQUARE, 20.3, 3), (260, 220))
    assert lfcal.calibrate(image, pitch=21.0).lattice.pitch == pytest.approx(20.3, abs=0.01)
    with pytest.raises(lfcal.CalibrationError, match="a pattern repeats every 31"):
        lfcal.calibrate(image, pitch=31.0)
    with pytest.raises(ValueError, match="give both"):
        lfcal.calibrate(image, rotation=3.0)


@pytest.mark.parametrize("pitch", [5.0, 20.0])
def test_an_even_flat_is_refused_whatever_is_stated(pitch):
    with pytest.raises(lfcal.CalibrationError, match="even grey"):
        lfcal.calibrate(np.full((300, 400), 100, np.uint8), pitch=pitch)
