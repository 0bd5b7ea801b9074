"""Camera files of key : value lines."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import lfcal
from lfcal.camera_files.read_write import convert

_HEXAGON = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60
)
@given(
    stretch=st.floats(0.999, 1.001),
    pitch=st.floats(6, 120),
    degrees=st.floats(-90, 90),
    x=st.floats(-500, 900),
    y=st.floats(-500, 900),
)
def test_hexagonal_lattice_at_any_angle_is_read_again_from_corner_centres(
    make_camera, tmp_path, stretch, pitch, degrees, x, y
):
    camera = make_camera(_HEXAGON, pitch, degrees, stretch, x, y)
    convert(camera, tmp_path / "camera.cfg")
    assert lfcal.compare(camera, lfcal.load(tmp_path / "camera.cfg")).max < 1e-3


def test_square_lattice_is_refused(make_camera, tmp_path):
    with pytest.raises(lfcal.CameraFileError, match="hexagonal"):
        convert(make_camera(np.eye(2), 20, 3), tmp_path / "camera.cfg")
    assert not list(tmp_path.iterdir())


def test_central_microimage_and_level_rows_are_read_and_other_sizes_refused(tmp_path):
    path = tmp_path / "camera.cfg"
    text = "# made by hand\n\nLensletWidth : {}\nLensletHeight : 80\n"
    text += "MIDiameter : {}\nMLADirection : 0\n"
    text += "CentralMIOffsetX : 1\nCentralMIOffsetY : 2\n"
    path.write_text(text.format(100, 20))
    np.testing.assert_allclose(lfcal.load(path).lattice.origin, [50.5, 37.5])
    with pytest.raises(lfcal.CameraFileError, match="100 x 80"):
        lfcal.load(path, (200, 80))
    for width, pitch, message in (
        (100.5, 20, "LensletWidth"),
        (100, 1e9, "microimages"),
        (100, "wide", "MIDiameter"),
    ):
        path.write_text(text.format(width, pitch))
        with pytest.raises(lfcal.CameraFileError, match=message):
            lfcal.load(path)
    path.write_text("# one\nnothing of the kind\n")
    with pytest.raises(lfcal.CameraFileError, match="key : number"):
        lfcal.load(path)


def pairs(path):
    lines = (line.split(" : ") for line in path.read_text().splitlines())
    return {key: float(value) for key, value in lines}


def test_flag_of_the_mode_is_the_other_way_round_and_follows_from_the_focus_of_the_lens_types(
    make_camera, tmp_path
):
    camera = make_camera(_HEXAGON, 30, 0)
    path = tmp_path / "camera.cfg"
    for mode, flag in (("telescopic", 0), ("binocular", 1), (None, 1)):
        convert(camera, path, mode=mode)
        assert pairs(path)["IsKepler"] == flag
    types = lfcal.LensTypes([[0, 2, 1], [1, 0, 2], [2, 1, 0]], ordered=True, focus=[0.4, 0.3, 0.2])
    convert(replace(camera, lens_types=types), path)
    assert pairs(path)["IsKepler"] == 0


@pytest.mark.parametrize("upright", [False, True])
@pytest.mark.parametrize("mode, nearest", [("telescopic", 0), ("binocular", 2)])
@pytest.mark.parametrize("shift", [0, 11, 23])
def test_near_type_is_that_of_its_place_in_the_first_row_of_whole_microimages(
    make_camera, tmp_path, upright, mode, nearest, shift
):
    shape = _HEXAGON[:, ::-1] if upright else _HEXAGON
    # Centres at a whole microimage in the corner, which is number 0 of the first row.
    first = np.array([15.2 + shift, 15.1] if not upright else [15.1, 15.2 + shift])
    camera = make_camera(shape, 30, 0, x=first[0], y=first[1])
    types = lfcal.LensTypes([[0, 2, 1], [1, 0, 2], [2, 1, 0]], ordered=True)
    convert(replace(camera, lens_types=types), tmp_path / "camera.cfg", mode=mode)
    written = pairs(tmp_path / "camera.cfg")
    centre = np.array([639, 479]) / 2 + [written["CentralMIOffsetX"], -written["CentralMIOffsetY"]]
    index = camera.lattice.to_index(centre[None])
    np.testing.assert_allclose(index, np.rint(index), atol=1e-6)
    along = np.array([0.0, 30.0]) if upright else np.array([30.0, 0.0])
    places = np.array([first + (written["NearFocalLenType"]) * along])
    assert types.of(np.rint(camera.lattice.to_index(places)).astype(int)) == nearest


@pytest.mark.parametrize("name", ["Fujita2.png"])
def test_near_type_of_real_cameras_is_the_published_one(name, tmp_path):
    captures = Path(__file__).parents[4] / "shared" / "captures"
    if not (captures / name).exists():
        pytest.skip("the real captures are not here")
    camera = lfcal.calibrate(lfcal.read_flat(captures / name))
    convert(camera, tmp_path / "camera.cfg")
    published = pairs((captures / name).with_suffix(".published.cfg"))
    written = pairs(tmp_path / "camera.cfg")
    for key in ("IsKepler", "NearFocalLenType", "MLADirection"):
        assert written[key] == published[key], key


def test_corner_centres_are_whole_microimages_from_border_to_border(make_camera, tmp_path):
    convert(make_camera(_HEXAGON, 30, 0.5), tmp_path / "camera.cfg")
    written = pairs(tmp_path / "camera.cfg")
    assert 14 <= written["LeftTopMICenterX"] < 60 and 14 <= written["LeftTopMICenterY"] < 60
    assert 640 - 60 < written["RightBottomMICenterX"] < 640 - 14
    assert 480 - 75 < written["RightBottomMICenterY"] < 480 - 14
