"""Cameras in the forms of other programs keep their geometry."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import lfcal
from lfcal.camera_files.read_write import convert, read_camera
from lfcal.cli.main import main

_SIZE = (640, 480)
_HEXAGON = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])


def _camera(shape, pitch, degrees, stretch=1.0, x=300.0, y=200.0):
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    basis = pitch * np.asarray(shape) @ np.array([[cos, sin], [-sin, cos]]) * [stretch, 1]
    return lfcal.Calibration(lfcal.Lattice((x, y), basis, _SIZE, 0.45 * pitch))


def _largest_difference(a, b):
    assert len(a.lattice) == len(b.lattice)
    return lfcal.compare(a, b).max


_ANY = {
    "pitch": st.floats(6, 120),
    "degrees": st.floats(-90, 90),
    "x": st.floats(-500, 900),
    "y": st.floats(-500, 900),
}


@pytest.mark.parametrize("suffix", [".xml", ".csv", ".json"])
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=40)
@given(shape=st.sampled_from([np.eye(2), _HEXAGON, [[1, 0], [0, 1.3]], [[1, 0], [0.2, 1.0]]]), **_ANY)
def test_any_lattice_comes_back_to_a_thousandth_of_a_pixel(tmp_path, suffix, shape, pitch, degrees, x, y):
    camera = _camera(shape, pitch, degrees, x=x, y=y)
    convert(camera, tmp_path / f"camera{suffix}")
    again = read_camera(tmp_path / f"camera{suffix}", _SIZE)
    assert lfcal.compare(camera, again).max < 1e-3
    if suffix != ".csv":
        assert again.lattice.radius == pytest.approx(camera.lattice.radius, abs=1e-6)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)
@given(stretch=st.floats(0.999, 1.001), **_ANY)
def test_hexagons_turned_by_any_angle_come_back_from_corner_centres(tmp_path, stretch, pitch, degrees, x, y):
    camera = _camera(_HEXAGON, pitch, degrees, stretch, x, y)
    convert(camera, tmp_path / "camera.cfg")
    assert lfcal.compare(camera, lfcal.load(tmp_path / "camera.cfg")).max < 1e-3


def test_square_lattice_is_refused_by_the_form_of_corner_centres(tmp_path):
    with pytest.raises(lfcal.CameraFileError, match="hexagonal"):
        convert(_camera(np.eye(2), 20, 3), tmp_path / "camera.cfg")
    assert not list(tmp_path.iterdir())


def test_table_lists_every_centre_on_the_flat(tmp_path):
    camera = _camera(_HEXAGON, 40, 2)
    convert(camera, tmp_path / "camera.csv")
    table = np.loadtxt(tmp_path / "camera.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, :2], camera.lattice.indices())
    np.testing.assert_allclose(table[:, 2:], camera.lattice.centres(), atol=1e-6)


@pytest.mark.parametrize(
    "text",
    ["", "a,b\n1,2\n", "i,j,x,y\n", "i,j,x,y\n0,0,1,nan\n", "i,j,x,y\n0,0,1,1\n1,0,5,1\n2,0,9,1\n", "i,j,x,y\n1,2\n"],
)
def test_damaged_table_is_refused_with_its_name(tmp_path, text):
    (tmp_path / "camera.csv").write_text(text)
    with pytest.raises(lfcal.CameraFileError, match=r"camera\.csv"):
        read_camera(tmp_path / "camera.csv", _SIZE)


def test_table_of_bent_rows_is_read_with_a_warning(tmp_path):
    camera = _camera(_HEXAGON, 40, 2)
    x, y = (camera.lattice.centres() + 1e-4 * (camera.lattice.centres() - 300) ** 2).T
    rows = np.column_stack([camera.lattice.indices(), x, y])
    np.savetxt(tmp_path / "camera.csv", rows, fmt="%.9g", delimiter=",", header="i,j,x,y", comments="")
    assert "off the straight lattice" in read_camera(tmp_path / "camera.csv", _SIZE).warnings[0]


def test_entity_bomb_is_refused_at_once(tmp_path):
    entities = "".join(
        f'<!ENTITY e{n} "{"&e" + str(n - 1) + ";" if n else "ha"}{"&e0;" * 9 if n else ""}">' for n in range(9)
    )
    (tmp_path / "bomb.xml").write_text(
        f"<?xml version='1.0'?><!DOCTYPE x [{entities}]><RayCalibData>&e8;</RayCalibData>"
    )
    with pytest.raises(lfcal.CameraFileError, match=r"bomb\.xml: not valid XML"):
        read_camera(tmp_path / "bomb.xml", _SIZE)


def _run(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments], catch_exceptions=False)


def test_command_asks_for_the_size_that_the_file_does_not_say(tmp_path):
    camera = _camera(_HEXAGON, 40, 2)
    convert(camera, tmp_path / "camera.xml")
    refused = _run("info", tmp_path / "camera.xml")
    assert refused.exit_code == 2 and "--size WxH" in refused.stderr
    assert _run("info", tmp_path / "camera.xml", "--size", "640").exit_code == 2
    cv2.imwrite(str(tmp_path / "flat.png"), np.zeros(_SIZE[::-1], np.uint8))
    for option in (("--size", "640x480"), ("--image", tmp_path / "flat.png")):
        result = _run("info", tmp_path / "camera.xml", *option, "--json")
        assert json.loads(result.stdout)["pitch"] == pytest.approx(40)


def test_command_converts_to_every_form_and_back(tmp_path):
    camera = _camera(_HEXAGON, 40, 2)
    camera.save(tmp_path / "a.json")
    for suffix in ("xml", "cfg", "csv"):
        assert _run("convert", tmp_path / "a.json", "-o", tmp_path / f"b.{suffix}").exit_code == 0
        back = _run("convert", tmp_path / f"b.{suffix}", "-o", tmp_path / "c.json", "--size", "640x480")
        assert back.exit_code == 0, back.output
        assert _largest_difference(camera, lfcal.load(tmp_path / "c.json")) < 1e-3
    assert _run("convert", tmp_path / "a.json", "-o", tmp_path / "b.txt").exit_code == 2


@pytest.mark.parametrize("upright", [False, True])
def test_three_lens_types_and_their_depths_come_back_from_xml(tmp_path, upright):
    camera = _camera(_HEXAGON[:, ::-1] if upright else _HEXAGON, 23.2, 1.5)
    sort = (np.add if (camera.lattice.steps.sum(1) % 3 != 0).all() else np.subtract).outer(np.arange(3), np.arange(3))
    cell = np.array([2, 0, 1])[sort % 3]
    camera = replace(camera, lens_types=lfcal.LensTypes(cell, True, np.array([-0.4, -0.3, -0.2])))
    convert(camera, tmp_path / "camera.xml")
    again = read_camera(tmp_path / "camera.xml", _SIZE)
    places = np.rint(again.lattice.to_index(camera.lattice.centres())).astype(int)
    np.testing.assert_array_equal(again.lens_types.of(places), camera.lens_types.of(camera.lattice.indices()))
    # Types part half way between their foci: 1 / 0.35 and 1 / 0.25.
    text = (tmp_path / "camera.xml").read_text()
    assert [float(v) for v in re.findall(r"<m..>([\d.]+)", text)] == pytest.approx([1, 1 / 0.35, 1 / 0.35, 4, 4, 100])


def test_published_lens_types_are_told_apart_but_their_order_is_not_believed(shared):
    published = lfcal.load(shared("captures/Fujita2.published.xml"), (2048, 2048))
    assert not published.lens_types.ordered and any("order of the lens types" in w for w in published.warnings)
    lattice = published.lattice
    types = published.lens_types.of(lattice.indices())
    assert np.bincount(types).min() > 0.33 * len(types)
    for step in lattice.steps:
        assert (published.lens_types.of(lattice.indices() + step) != types).all()


def test_lens_types_off_the_lattice_are_left_out_with_a_warning(tmp_path):
    camera = replace(_camera(_HEXAGON, 20.0, 0.0), lens_types=lfcal.LensTypes([[0, 1, 2], [2, 0, 1], [1, 2, 0]]))
    convert(camera, tmp_path / "camera.xml")
    text = (tmp_path / "camera.xml").read_text()
    types = text.index("<lens_type id")
    (tmp_path / "camera.xml").write_text(text[:types] + text[types:].replace("1.0", "1.5").replace("0.5", "0.8"))
    again = lfcal.load(tmp_path / "camera.xml", _SIZE)
    assert again.lens_types is None and any("left out" in w for w in again.warnings)
