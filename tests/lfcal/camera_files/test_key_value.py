"""Camera files of key : value lines."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import lfcal
from lfcal.camera_files.read_write import convert

_HEXAGON = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)
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


def test_key_value_file_of_another_image_size_is_refused(tmp_path):
    text = "IsKepler : 1\nLensletWidth : 100\nLensletHeight : 80\nMIDiameter : 20\nMLADirection : 0\n"
    text += "CentralMIOffsetX : 1\nCentralMIOffsetY : 2\n"
    path = tmp_path / "camera.cfg"
    path.write_text(text)
    np.testing.assert_allclose(lfcal.load(path).lattice.origin, [50.5, 37.5])
    with pytest.raises(lfcal.CameraFileError, match="100 x 80"):
        lfcal.load(path, (200, 80))
