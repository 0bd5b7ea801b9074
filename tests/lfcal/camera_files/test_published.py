"""Published camera files: conventions, contradictions and damage."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from lfcal.camera_files.published import read_published

_RAYTRIX = """<RayCalibData version="1.0">
  <offset units="pix"><x>{x}</x><y>{y}</y></offset>
  <diameter units="pix">20.0</diameter><rotation units="rad">{rotation}</rotation>
  <lens_border units="pix">1.0</lens_border>
  <lens_base_x units="lens"><x>{ax}</x><y>{ay}</y></lens_base_x>
  <lens_base_y units="lens"><x>{bx}</x><y>{by}</y></lens_base_y>
</RayCalibData>"""

_CORNERS = """<TSPCCalibData><diameter unit="pix">70</diameter><rotation unit="rad">{rotation}</rotation><centers>
<ltop><x>35</x><y>40</y></ltop><rtop><x>{right}</x><y>{top}</y></rtop>
<lbot><x>35</x><y>740</y></lbot><rbot><x>{right}</x><y>{low}</y></rbot></centers></TSPCCalibData>"""


def _raytrix(rotation=0.0, turned=0.0, x=3.0, y=5.0):
    a = np.array([np.cos(turned), np.sin(turned)])
    b = np.array([np.cos(turned + np.pi / 3), np.sin(turned + np.pi / 3)])
    return _RAYTRIX.format(rotation=rotation, x=x, y=y, ax=a[0], ay=a[1], bx=b[0], by=b[1])


@pytest.fixture
def written(tmp_path):
    def write(text, name="camera.xml"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


def _holds(lattice, vector):
    index = np.asarray(vector) @ np.linalg.inv(lattice.basis)
    return np.abs(index - np.rint(index)).max() < 1e-6


def test_raytrix_offset_points_up_from_the_image_centre(written):
    camera = lfcal.load(written(_raytrix()), (101, 81))
    np.testing.assert_allclose(camera.lattice.origin, [50 + 3, 40 - 5])
    assert camera.lattice.pitch == pytest.approx(20.0)
    assert camera.lattice.radius == pytest.approx(9.0)
    assert camera.source == "published" and camera.warnings == ()


def test_raytrix_rotation_turns_counter_clockwise_on_the_screen(written):
    lattice = lfcal.load(written(_raytrix(rotation=0.05)), (101, 81)).lattice
    assert _holds(lattice, [20 * np.cos(0.05), -20 * np.sin(0.05)])


def test_raytrix_rotation_given_twice_is_applied_once_and_said(written):
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


def test_pairs_and_xml_of_one_camera_agree(shared):
    for name, size in (("Fujita2", (2048, 2048)), ("Boys2", (3976, 2956)), ("MiniGarden2", (4036, 3064))):
        pairs = lfcal.load(shared("captures", f"{name}.published.cfg")).lattice
        xml = lfcal.load(shared("captures", f"{name}.published.xml"), size).lattice
        np.testing.assert_allclose(np.abs(np.linalg.det(pairs.basis)), np.abs(np.linalg.det(xml.basis)), rtol=1e-6)
        assert _holds(xml, pairs.origin - xml.origin)


def test_image_size_is_asked_for_where_the_file_does_not_say(written):
    with pytest.raises(lfcal.CameraFileError, match="image_size"):
        read_published(written(_raytrix()))


def test_pairs_of_another_image_size_are_refused(written):
    text = "IsKepler : 1\nLensletWidth : 100\nLensletHeight : 80\nMIDiameter : 20\nMLADirection : 0\n"
    text += "CentralMIOffsetX : 1\nCentralMIOffsetY : 2\n"
    path = written(text, "camera.cfg")
    np.testing.assert_allclose(lfcal.load(path).lattice.origin, [50.5, 37.5])
    with pytest.raises(lfcal.CameraFileError, match="100 x 80"):
        lfcal.load(path, (200, 80))


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
        "MIDiameter : 20\n",
        "MIDiameter : 20\nLensletWidth = 5\n",
    ],
)
def test_damaged_file_is_refused_with_its_name(written, text):
    path = written(text)
    with pytest.raises(lfcal.CameraFileError, match=r"camera\.xml"):
        lfcal.load(path, (101, 81))
