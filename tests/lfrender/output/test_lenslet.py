"""Views of a grid as the flat of a regular lens array, and back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.ndimage import gaussian_filter, map_coordinates

import lfcal
import lfrender
from lfrender.cli.main import main
from lfrender.output.lenslet import lenslet_image, lenslet_views, read_view_grid
from lfrender.output.views import write_grid

RNG = np.random.default_rng(6)


def run(*words):
    return CliRunner().invoke(main, ["lenslet", *map(str, words)])


@pytest.mark.parametrize(
    ("shape", "kind"), [((3, 5, 20, 30, 3), np.uint8), ((5, 5, 12, 16), np.uint16)]
)
def test_views_become_a_flat_and_the_same_views_again(tmp_path, shape, kind):
    views = RNG.integers(0, 256, shape).astype(kind)
    write_grid(tmp_path / "views", views.reshape(-1, *shape[2:]), shape[1], ".png")
    made = run(tmp_path / "views", "-o", tmp_path / "flat.tif", "--json")
    assert made.exit_code == 0, made.output
    flat = lfcal.read_flat(tmp_path / "flat.tif")
    camera = lfcal.load(tmp_path / "flat.json")
    x = 7
    y = 4
    u = 3
    v = 2
    np.testing.assert_array_equal(flat[y * shape[0] + v, x * shape[1] + u], views[v, u, y, x])
    assert camera.image_size == flat.shape[1::-1] and len(camera.lattice) == shape[2] * shape[3]
    back = run(
        tmp_path / "flat.tif", "-c", tmp_path / "flat.json", "-o", tmp_path / "again", "--json"
    )
    assert json.loads(back.stdout)["grid"] == list(shape[:2])
    again = read_view_grid([tmp_path / "again"])
    np.testing.assert_array_equal(again, views)
    assert again.dtype == kind


def test_what_is_no_grid_is_refused_in_one_line(tmp_path):
    view = np.zeros((20, 30), np.uint8)
    for row, column, size in ((0, 0, 30), (0, 1, 30), (1, 0, 30), (2, 1, 29)):
        lfrender.write_picture(tmp_path / f"cam_{row}_{column}.png", view[:, :size])
    corner = [tmp_path / f"cam_{name}.png" for name in ("0_0", "0_1", "1_0", "2_1")]
    for words, message in (
        ([tmp_path], "no view of row 1, column 1"),
        ([*corner, "--grid", "1x3"], "needs 3 views, 4 are there"),
        (
            [*corner[:2], corner[3], "--grid", "1x3"],
            "cam_2_1.png: is 29 x 20 px of uint8, the first is 30 x 20",
        ),
        ([tmp_path / "nothing"], "nothing"),
        ([*corner[:2], "-c", corner[0]], "one flat is wanted"),
    ):
        done = run(*words, "-o", tmp_path / "flat.png")
        assert done.exit_code == 2 and message in done.stderr and done.stderr.count("\n") == 1, (
            done.output
        )
    lfrender.write_picture(tmp_path / "view.png", view)
    assert "--grid" in run(tmp_path / "view.png", "-o", tmp_path / "flat.png").stderr
    assert not (tmp_path / "flat.png").exists() and not (tmp_path / "flat.json").exists()


def test_the_camera_of_another_array_is_refused():
    flat, camera, _ = lfrender.data.example()
    with pytest.raises(lfcal.CameraFileError, match="no rectangles of whole pixels"):
        lenslet_views(flat, camera)


def test_a_lattice_that_is_found_rather_than_stated_gives_the_whole_microimages():
    views = RNG.integers(0, 255, (4, 6, 10, 12)).astype(np.uint8)
    flat, camera = lenslet_image(views)
    lattice = lfcal.Lattice([2.5 + 6.02, 1.52], camera.lattice.basis + 1e-3, (70, 40), 2.0)
    found = lenslet_views(flat[:, 2:], lfcal.Calibration(lattice, source="white"))
    np.testing.assert_array_equal(found, lenslet_views(flat[:, 2:], lfcal.Calibration(lattice)))
    assert found.shape == (4, 6, 10, 11)
    np.testing.assert_array_equal(found[:, 0], views[:, 2, :, :-1])


def _views_of_a_plane(disparity, side):
    """Views (side, side, h, w) of a random texture, displaced as the HCI benchmark defines its
    disparity.
    """
    rng = np.random.default_rng(3)
    texture = gaussian_filter(rng.standard_normal((160, 180)), 1.0)
    texture = (texture - texture.min()) / np.ptp(texture)
    row, column = np.mgrid[:60, :80].astype(float)
    middle = (side - 1) / 2
    views = np.empty((side, side, 60, 80), np.uint8)
    for v, u in np.ndindex(side, side):
        # What is at x in the middle view is at x - (u - middle) d in the view of column u.
        places = [row + 50 + (v - middle) * disparity, column + 50 + (u - middle) * disparity]
        views[v, u] = np.rint(255 * np.clip(map_coordinates(texture, places), 0, 1))
    return views


@pytest.mark.parametrize("disparity", [0.3, -0.4])
def test_an_hci_disparity_is_the_negative_reciprocal_of_the_patch_size(disparity):
    depth = lfrender.analyze(*lenslet_image(_views_of_a_plane(disparity, 13)), preset="fast")
    assert np.nanmedian(depth.patch_size) == pytest.approx(-1 / disparity, abs=0.02)
    text = (Path(__file__).parents[3] / "docs" / "formats.md").read_text(encoding="utf-8")
    assert "becomes a patch size of `-1 / d` px" in text


@pytest.mark.parametrize(("side", "warned"), [(9, True), (13, False)])
def test_arrays_of_few_pixels_a_lens_are_warned_of(tmp_path, side, warned):
    write_grid(tmp_path / "views", _views_of_a_plane(0.3, side).reshape(-1, 60, 80), side, ".png")
    made = run(tmp_path / "views", "-o", tmp_path / "flat.png")
    drawn = CliRunner().invoke(
        main,
        [
            "render",
            *map(
                str,
                (
                    tmp_path / "flat.png",
                    "-c",
                    tmp_path / "flat.json",
                    "-o",
                    tmp_path / "picture.png",
                ),
            ),
        ],
    )
    assert (made.exit_code, drawn.exit_code) == (0, 0)
    for done in (made, drawn):
        assert (f"microimages of {side} px are small for depth" in done.stderr) == warned
