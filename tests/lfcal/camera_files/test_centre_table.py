"""Tables of centres: ours, and those of makers in any order of lines and columns, y up or down."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import lfcal
from lfcal.camera_files.read_write import convert
from lfcal.cli.main import main
from lfcal.display.camera_check import choose_orientation
from lfcal.lattice.distortion import Distortion

HEXAGON = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])
TYPES = lfcal.LensTypes([[0, 2, 1], [1, 0, 2], [2, 1, 0]])
SIZE = (640, 480)


@pytest.fixture(scope="module")
def camera(make_camera):
    return replace(make_camera(HEXAGON, 23, 2), lens_types=TYPES)


@pytest.fixture(scope="module")
def white(camera):
    """A white image: discs on black."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    points = np.column_stack([x.ravel(), y.ravel()])
    index = np.rint(camera.lattice.to_index(points))
    beside = [
        camera.lattice.points(index + step) - points for step in [(0, 0), *camera.lattice.steps]
    ]
    return (
        np.where(np.hypot(*np.moveaxis(beside, -1, 0)).min(0) < 9.5, 200, 20)
        .reshape(y.shape)
        .astype(np.uint8)
    )


def table_of(camera, y_up=False, noise=0.0, bend=0.0):
    """Rows x, y, radius, type of a camera in any order, some centres missing."""
    index = camera.lattice.indices()
    centres = camera.lattice.centres()
    rng = np.random.default_rng(1)
    centres = centres + bend * (centres - 300) ** 2 + rng.normal(0, noise, centres.shape)
    centres[:, 1] = SIZE[1] - 1 - centres[:, 1] if y_up else centres[:, 1]
    rows = np.column_stack([centres, np.full(len(centres), 9.5), camera.lens_types.of(index) + 1])
    return rng.permutation(rows)[5:]


def misfit(camera, other):
    """Largest distance [px] of centres from the nearest of the other camera, and whether types are
    parted alike.
    """
    centres = camera.lattice.centres()
    index = np.rint(other.lattice.to_index(centres)).astype(int)
    pairs = np.column_stack(
        [camera.lens_types.of(camera.lattice.indices()), other.lens_types.of(index)]
    )
    return np.abs(other.lattice.points(index) - centres).max(), len(
        np.unique(pairs, axis=0)
    ) == camera.lens_types.count


@pytest.mark.parametrize(
    ("y_up", "form", "columns"),
    [
        (True, {"delimiter": ","}, [0, 1, 2, 3]),
        (False, {"delimiter": " ", "header": "type cx cy r"}, [3, 0, 1, 2]),
        (
            True,
            {"delimiter": ";", "header": "id;Y [px];lens_type;X [px];radius", "comments": ""},
            [3, 1, 3, 0, 2],
        ),
    ],
)
def test_a_makers_table_in_any_order_gives_the_lattice_and_the_image_which_way_y_points(
    camera, white, tmp_path, y_up, form, columns
):
    np.savetxt(
        tmp_path / "centres.txt", table_of(camera, y_up, 0.05)[:, columns], fmt="%.4f", **form
    )
    readings = [lfcal.load(tmp_path / "centres.txt", SIZE, y_up=up) for up in (False, True)]
    found = choose_orientation(*readings, white)
    apart, same_types = misfit(camera, found)
    assert apart < 0.02 and same_types
    assert found.lattice.radius == 9.5
    assert found.residual_rms == pytest.approx(0.05 * np.sqrt(2), rel=0.1)
    assert found is readings[y_up]


def test_the_command_converts_a_table_and_says_how_well_the_centres_keep_to_the_lattice(
    camera, white, tmp_path
):
    np.savetxt(tmp_path / "table.csv", table_of(camera, True), fmt="%.4f", delimiter=",")
    cv2.imwrite(str(tmp_path / "white.png"), white)
    words = ["convert", str(tmp_path / "table.csv"), "-o", str(tmp_path / "camera.json")]
    done = CliRunner().invoke(main, [*words, "--image", str(tmp_path / "white.png")])
    assert done.exit_code == 0 and "0.000 px (RMS) from the centres" in done.output
    assert misfit(camera, lfcal.load(tmp_path / "camera.json"))[0] < 1e-3
    up = CliRunner().invoke(main, [*words, "--size", "640x480", "--y-up", "--json"])
    assert json.loads(up.stdout)["lens_types"]["count"] == 3


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-be", "utf-16-le", "utf-32"])
def test_tables_of_other_encodings_are_read(camera, tmp_path, encoding):
    convert(camera, tmp_path / "plain.csv")
    text = (tmp_path / "plain.csv").read_text(encoding="utf-8")
    if encoding == "utf-16-be":
        text = "\ufeff" + text
    (tmp_path / "table.csv").write_text(text, encoding=encoding)
    assert lfcal.load(tmp_path / "table.csv", SIZE) == lfcal.load(tmp_path / "plain.csv", SIZE)


def test_an_image_that_shows_nothing_leaves_a_warning(camera, tmp_path):
    np.savetxt(tmp_path / "table.csv", table_of(camera), fmt="%.4f", delimiter=",")
    readings = [lfcal.load(tmp_path / "table.csv", SIZE, y_up=up) for up in (False, True)]
    found = choose_orientation(
        *readings, np.random.default_rng(0).integers(99, 101, SIZE[::-1], np.uint8)
    )
    assert any("does not show whether y" in text for text in found.warnings)
    assert misfit(camera, found)[0] < 0.02


def test_our_table_keeps_centres_radius_types_and_distortion(camera, tmp_path):
    bend = Distortion.zero(SIZE)
    bend = replace(bend, general=np.linspace(-1, 1, 14).reshape(2, 7), middle=bend.centre)
    camera = replace(camera, lattice=replace(camera.lattice, distortion=bend))
    convert(camera, tmp_path / "camera.csv")
    table = np.loadtxt(tmp_path / "camera.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, 2:4], camera.lattice.centres(), atol=1e-6)
    found = lfcal.load(tmp_path / "camera.csv", SIZE)
    assert misfit(camera, found) == (pytest.approx(0, abs=1e-3), True)
    assert found.lattice.radius == pytest.approx(camera.lattice.radius)


def test_centres_far_off_a_lattice_and_types_that_do_not_repeat_are_told(camera, tmp_path):
    rows = table_of(camera, noise=0.5)
    rows[:, 3] = np.random.default_rng(0).integers(0, 3, len(rows))
    np.savetxt(tmp_path / "table.csv", rows, delimiter=",")
    found = lfcal.load(tmp_path / "table.csv", SIZE)
    assert found.lens_types is None and "do not repeat" in found.warnings[0]
    assert found.residual_rms == pytest.approx(0.7, rel=0.1) and "px (RMS) off" in found.warnings[1]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "a,b\n1,2\n",
        "i,j,x,y\n",
        "i,j,x,y\n0,0,1,nan\n",
        "i,j,x,y\n0,0,1,1\n1,0,5,1\n2,0,9,1\n",
        "i,j,x,y\n1,2\n",
        "x,y\n1,1\n9,1\n17,1\n",
        "1,1\n9,1\n4,far\n",
        "1 2\n30 400\n17 90\n99 3\n222 314\n",
    ],
)
def test_damaged_table_is_refused_with_its_name(tmp_path, text):
    (tmp_path / "camera.csv").write_text(text)
    with pytest.raises(lfcal.CameraFileError, match=r"camera\.csv"):
        lfcal.load(tmp_path / "camera.csv", SIZE)
