"""Differences of two calibrations over the field."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

import lfcal
from lfcal.camera_files.read_write import convert
from lfcal.cli.main import main

_SIZE = (900, 700)
_HEXAGON = np.array([[20.0, 0.0], [10.0, 300**0.5]])


def _camera(origin=(450.0, 350.0), basis=_HEXAGON, size=_SIZE):
    return lfcal.Calibration(lfcal.Lattice(origin, basis, size, 9.0))


@given(i=st.integers(-9, 9), j=st.integers(-9, 9), dx=st.floats(-4, 4), dy=st.floats(-4, 4))
def test_shift_is_found_whatever_origin_and_basis_a_lattice_has(i, j, dx, dy):
    other = np.array([[0, 1], [-1, 1]]) @ _HEXAGON
    moved = _camera((450 + dx, 350 + dy) + np.array([i, j]) @ _HEXAGON, other)
    difference = lfcal.compare(_camera(), moved)
    np.testing.assert_allclose(difference.mean_shift, [dx, dy], atol=1e-9)
    assert difference.rms == pytest.approx(np.hypot(dx, dy), abs=1e-9)
    assert difference.max == pytest.approx(np.hypot(dx, dy), abs=1e-9)
    np.testing.assert_allclose(
        difference.field.reshape(-1, 2), np.tile([dx, dy], (9, 1)), atol=1e-9
    )


def test_scale_and_rotation_are_distinguished_and_grow_beyond_half_a_pitch():
    angle = np.radians(0.5)
    turn = 1.02 * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    difference = lfcal.compare(_camera(), _camera(basis=_HEXAGON @ turn))
    assert difference.scale == pytest.approx(1.02)
    assert difference.rotation_degrees == pytest.approx(0.5)
    corner = np.hypot(449.5, 349.5) * np.hypot(1.02 * np.cos(angle) - 1, 1.02 * np.sin(angle))
    np.testing.assert_allclose(np.linalg.norm(difference.field[0, 0]), corner, rtol=0.01)
    assert difference.max > 10


@pytest.mark.parametrize("basis", [2 * _HEXAGON, np.eye(2) * 20, _HEXAGON[:, ::-1]])
def test_different_lattices_are_not_compared(basis):
    with pytest.raises(lfcal.CalibrationError, match="different"):
        lfcal.compare(_camera(), _camera(basis=basis))


def test_different_sizes_are_not_compared():
    with pytest.raises(lfcal.CalibrationError, match="900 x 700 and 300 x 200"):
        lfcal.compare(_camera(), _camera(size=(300, 200)))


def test_command_compares_a_json_file_with_a_published_one(tmp_path):
    _camera().save(tmp_path / "a.json")
    convert(_camera((450.5, 350)), tmp_path / "b.xml")
    result = CliRunner().invoke(
        main, ["compare", str(tmp_path / "a.json"), str(tmp_path / "b.xml"), "--json"]
    )
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    assert figures["rms"] == pytest.approx(0.5, abs=1e-3)
    assert figures["field"]["bottom right"] == pytest.approx([0.5, 0.0], abs=1e-3)
    swapped = CliRunner().invoke(
        main, ["compare", str(tmp_path / "b.xml"), str(tmp_path / "a.json"), "--json"]
    )
    assert json.loads(swapped.stdout)["mean_shift"] == pytest.approx([-0.5, 0.0], abs=1e-3)
