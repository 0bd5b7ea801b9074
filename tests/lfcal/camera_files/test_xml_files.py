"""XML camera files: conventions, contradictions and damage."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import lfcal
from lfcal.camera_files.read_write import convert

_HEXAGON = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])

_RAYTRIX = """<RayCalibData version="1.0">
  <offset units="pix"><x>{x}</x><y>{y}</y></offset>
  <diameter units="pix">20.0</diameter><rotation units="rad">{rotation}</rotation>
  <lens_border units="pix">1.0</lens_border>
  <lens_base_x units="lens"><x>{ax}</x><y>{ay}</y></lens_base_x>
  <lens_base_y units="lens"><x>{bx}</x><y>{by}</y></lens_base_y>
</RayCalibData>"""

_CORNERS = """<TSPCCalibData><diameter unit="pix">70</diameter>
<rotation unit="rad">{rotation}</rotation>
<centers><ltop><x>35</x><y>40</y></ltop><rtop><x>{right}</x><y>{top}</y></rtop>
<lbot><x>35</x><y>740</y></lbot><rbot><x>{right}</x><y>{low}</y></rbot></centers></TSPCCalibData>"""


def _raytrix(rotation=0.0, turned=0.0, x=3.0, y=5.0):
    a = np.array([np.cos(turned), np.sin(turned)])
    b = np.array([np.cos(turned + np.pi / 3), np.sin(turned + np.pi / 3)])
    return _RAYTRIX.format(rotation=rotation, x=x, y=y, ax=a[0], ay=a[1], bx=b[0], by=b[1])


@pytest.fixture
def written(tmp_path):
    def write(text):
        (tmp_path / "camera.xml").write_text(text)
        return tmp_path / "camera.xml"

    return write


def _holds(lattice, vector):
    index = np.asarray(vector) @ np.linalg.inv(lattice.basis)
    return np.abs(index - np.rint(index)).max() < 1e-6


def test_raytrix_offset_points_up_from_the_image_centre_and_rotation_turns_counter_clockwise(
    written,
):
    camera = lfcal.load(written(_raytrix(rotation=0.05)), (101, 81))
    np.testing.assert_allclose(camera.lattice.origin, [50 + 3, 40 - 5])
    assert (camera.lattice.pitch, camera.lattice.radius) == pytest.approx((20.0, 9.0))
    assert _holds(camera.lattice, [20 * np.cos(0.05), -20 * np.sin(0.05)])
    assert camera.source == "published" and camera.warnings == ()


def test_raytrix_rotation_given_twice_is_applied_once_with_a_warning(written):
    camera = lfcal.load(written(_raytrix(rotation=np.pi / 2, turned=np.pi / 2)), (101, 81))
    assert _holds(camera.lattice, [0, 20])
    assert any("twice" in warning for warning in camera.warnings)


@pytest.mark.parametrize("columns", [10, 11])
def test_corner_centres_give_an_upright_hexagonal_lattice(written, columns):
    right = 35 + columns * 70 * np.sqrt(0.75)
    slip = 35 if columns % 2 else 0
    text = _CORNERS.format(rotation=np.pi / 2, right=right, top=40 + slip, low=740 + slip)
    camera = lfcal.load(written(text), (900, 800))
    assert _holds(camera.lattice, [0, 70]) and _holds(camera.lattice, [70 * np.sqrt(0.75), 35])
    assert _holds(camera.lattice, camera.lattice.origin - [35, 40])
    assert camera.warnings


def test_key_value_and_xml_files_of_one_camera_agree(shared):
    for name, size in (
        ("Fujita2", (2048, 2048)),
        ("Boys2", (3976, 2956)),
        ("MiniGarden2", (4036, 3064)),
    ):
        pairs = lfcal.load(shared("captures", f"{name}.published.cfg")).lattice
        xml = lfcal.load(shared("captures", f"{name}.published.xml"), size).lattice
        np.testing.assert_allclose(
            np.abs(np.linalg.det(pairs.basis)), np.abs(np.linalg.det(xml.basis)), rtol=1e-6
        )
        assert _holds(xml, pairs.origin - xml.origin)


def test_image_size_is_asked_for_where_the_file_does_not_say(written):
    with pytest.raises(lfcal.CameraFileError, match="image_size"):
        lfcal.load(written(_raytrix()))


_BOMB = "".join(
    f'<!ENTITY e{n} "{"&e" + str(n - 1) + ";" if n else "ha"}{"&e0;" * 9 if n else ""}">'
    for n in range(9)
)


@pytest.mark.parametrize(
    "text",
    [
        "<RayCalibData>",
        "<Other/>",
        "<RayCalibData/>",
        _raytrix().replace("20.0", "nan"),
        _raytrix().replace("20.0", "-3"),
        _raytrix().replace("20.0", "wide"),
        '<!DOCTYPE a [<!ENTITY b "c">]><RayCalibData>&b;</RayCalibData>',
        f"<?xml version='1.0'?><!DOCTYPE x [{_BOMB}]><RayCalibData>&e8;</RayCalibData>",
        "MIDiameter : 20\n",
        "MIDiameter : 20\nLensletWidth = 5\n",
    ],
)
def test_damaged_or_hostile_file_is_refused_with_its_name(written, text):
    with pytest.raises(lfcal.CameraFileError, match=r"camera\.xml"):
        lfcal.load(written(text), (101, 81))


@pytest.mark.parametrize("upright", [False, True])
def test_three_lens_types_and_their_depths_are_read_again_from_xml(make_camera, tmp_path, upright):
    camera = make_camera(_HEXAGON[:, ::-1] if upright else _HEXAGON, 23.2, 1.5)
    sort = (np.add if (camera.lattice.steps.sum(1) % 3 != 0).all() else np.subtract).outer(
        np.arange(3), np.arange(3)
    )
    cell = np.array([2, 0, 1])[sort % 3]
    camera = replace(camera, lens_types=lfcal.LensTypes(cell, True, np.array([-0.4, -0.3, -0.2])))
    convert(camera, tmp_path / "camera.xml")
    again = lfcal.load(tmp_path / "camera.xml", (640, 480))
    places = np.rint(again.lattice.to_index(camera.lattice.centres())).astype(int)
    np.testing.assert_array_equal(
        again.lens_types.of(places), camera.lens_types.of(camera.lattice.indices())
    )
    # The border of two types is half way between their foci: 1 / 0.35 and 1 / 0.25.
    text = (tmp_path / "camera.xml").read_text()
    assert [float(v) for v in re.findall(r"<m..>([\d.]+)", text)] == pytest.approx(
        [1, 1 / 0.35, 1 / 0.35, 4, 4, 100]
    )


def test_published_lens_types_are_distinguished_but_their_order_is_not_used(shared):
    published = lfcal.load(shared("captures/Fujita2.published.xml"), (2048, 2048))
    assert not published.lens_types.ordered and any(
        "order of the lens types" in w for w in published.warnings
    )
    lattice = published.lattice
    types = published.lens_types.of(lattice.indices())
    assert np.bincount(types).min() > 0.33 * len(types)
    for step in lattice.steps:
        assert (published.lens_types.of(lattice.indices() + step) != types).all()


def test_lens_types_off_the_lattice_are_left_out_with_a_warning(make_camera, tmp_path):
    camera = replace(
        make_camera(_HEXAGON, 20.0, 0.0),
        lens_types=lfcal.LensTypes([[0, 1, 2], [2, 0, 1], [1, 2, 0]]),
    )
    convert(camera, tmp_path / "camera.xml")
    text = (tmp_path / "camera.xml").read_text()
    types = text.index("<lens_type id")
    (tmp_path / "camera.xml").write_text(
        text[:types] + text[types:].replace("1.0", "1.5").replace("0.5", "0.8")
    )
    again = lfcal.load(tmp_path / "camera.xml", (640, 480))
    assert again.lens_types is None and any("left out" in w for w in again.warnings)
