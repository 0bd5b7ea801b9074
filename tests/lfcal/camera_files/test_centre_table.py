"""Tables of microimage centres."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from lfcal.camera_files.read_write import convert

_SIZE = (640, 480)
_HEXAGON = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])


def test_table_lists_every_centre_on_the_flat(make_camera, tmp_path):
    camera = make_camera(_HEXAGON, 40, 2)
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
        lfcal.load(tmp_path / "camera.csv", _SIZE)


def test_table_of_a_distorted_lattice_is_read_with_a_warning(make_camera, tmp_path):
    camera = make_camera(_HEXAGON, 40, 2)
    x, y = (camera.lattice.centres() + 1e-4 * (camera.lattice.centres() - 300) ** 2).T
    rows = np.column_stack([camera.lattice.indices(), x, y])
    np.savetxt(tmp_path / "camera.csv", rows, fmt="%.9g", delimiter=",", header="i,j,x,y", comments="")
    assert "off the straight lattice" in lfcal.load(tmp_path / "camera.csv", _SIZE).warnings[0]
