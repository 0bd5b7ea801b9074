"""The picture of a calibration over a flat."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.colors import to_rgb

import lfcal
from lfcal.camera.plotting import TYPE_COLOURS, draw_lenses
from lfcal.cli.main import main
from lfcal.display.overlay import find_places_to_check
from lfcal.gain.gain_map import Defects
from lfcal.lattice.standard_errors import Residuals


@pytest.fixture(scope="module")
def white(whites):
    basis = whites.turned(whites.HEXAGON, 20.3, 3)
    image, origin = whites.white_image(basis, (460, 400))
    return image, lfcal.Calibration(lfcal.Lattice(origin, basis, (460, 400), 9.0))


@pytest.fixture(scope="module")
def drawn_white(white):
    return lfcal.show(white[1], white[0])


def _pixels(picture, colour):
    return (np.abs(picture.astype(int) - 255 * np.array(to_rgb(colour))).max(-1) < 40).sum()


def test_circles_are_drawn_in_all_five_crops(drawn_white):
    picture = drawn_white
    assert picture.dtype == np.uint8 and picture.shape[2] == 3
    height, width = (side // 3 for side in picture.shape[:2])
    for x in (0, 2 * width):
        for y in (0, 2 * height):
            assert _pixels(picture[y : y + height, x : x + width], TYPE_COLOURS[0]) > 300


def test_any_pitch_and_pixel_type_is_drawn(whites, pitch=150.0):
    image, origin = whites.white_image(whites.turned(whites.SQUARE, pitch, 1), (620, 400))
    camera = lfcal.Calibration(lfcal.Lattice(origin, np.eye(2) * pitch, (620, 400), 0.45 * pitch))
    flat = (image / 65535).astype(np.float32)
    assert _pixels(lfcal.show(camera, np.repeat(flat[..., None], 3, axis=2)), TYPE_COLOURS[0]) > 500


def test_command_writes_the_picture_and_says_where_to_look(white, tmp_path):
    image, camera = white
    index = camera.lattice.indices()[[40, 300]]
    camera = replace(
        camera, residuals=Residuals(index, np.array([(0.01, 0.0), (0.0, -0.8)], np.float32))
    )
    cv2.imwrite(str(tmp_path / "flat.png"), image)
    camera.save(tmp_path / "camera.json")
    arguments = [
        "show",
        str(tmp_path / "camera.json"),
        "--image",
        str(tmp_path / "flat.png"),
        "--json",
    ]
    result = CliRunner().invoke(
        main, [*arguments, "-o", str(tmp_path / "show.png")], catch_exceptions=False
    )
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    assert figures["pitch"] == pytest.approx(20.3)
    (lens,) = figures["look_at"]
    assert "0.80 px" in lens and f"lens {index[1][0]}, {index[1][1]} " in lens
    written = cv2.imread(str(tmp_path / "show.png"))
    np.testing.assert_array_equal(written[..., ::-1], lfcal.show(camera, image))
    refused = CliRunner().invoke(main, [*arguments, "-o", str(tmp_path / "show.txt")])
    assert refused.exit_code == 2


def test_lens_types_have_their_own_colours_and_unlit_lenses_are_crossed_out(white, drawn_white):
    image, camera = white
    lattice = camera.lattice
    near = np.argmin(np.hypot(*(lattice.centres() - (229.5, 199.5)).T))
    marked = replace(
        camera,
        lens_types=lfcal.LensTypes([[0, 1, 2], [2, 0, 1], [1, 2, 0]], True),
        defects=Defects(lenses=lattice.indices()[[near]].astype(np.int32)),
    )
    plain = drawn_white
    picture = lfcal.show(marked, image)
    assert min(_pixels(picture, colour) for colour in TYPE_COLOURS[:3]) > 500
    assert _pixels(plain, TYPE_COLOURS[1]) < 50
    assert _pixels(picture, "magenta") > _pixels(plain, "magenta") + 60


@pytest.mark.parametrize("reach, square", [(11.0, False), (14.1, True)])
def test_lenses_with_light_in_the_corners_of_their_cells_are_drawn_as_squares(reach, square):
    from matplotlib.figure import Figure

    lattice = lfcal.Lattice([11, 10], [[22, 0], [0, 22]], (220, 110), 10.0)
    axes = Figure().subplots()
    draw_lenses(lattice, None, axes, np.arange(len(lattice)) == 0, reach)
    (outline,) = axes.collections[0].get_paths()
    corner = lattice.centres()[0] + 0.98 * reach / np.sqrt(2)
    assert outline.contains_point(corner) == square


def test_circles_are_looked_for_without_the_colour_filters(white):
    image, camera = white
    filtered = image.astype(np.float32)
    filtered[::2, ::2] *= 0.4
    filtered[1::2, 1::2] *= 0.6
    lattice = replace(camera.lattice, origin=camera.lattice.origin + 8)
    beside = replace(camera, lattice=lattice)
    (plain,) = find_places_to_check(beside, image)
    (place,) = find_places_to_check(replace(beside, mosaic="RGGB"), filtered)
    assert len(place.circles) > 0.9 * len(plain.circles)
    assert find_places_to_check(replace(camera, mosaic="RGGB"), filtered) == []


def test_nothing_is_to_be_looked_at_where_nothing_is_wrong(white):
    image, camera = white
    near = Residuals(camera.lattice.indices()[:2], np.array([(0.01, 0.0), (0.0, -0.3)], np.float32))
    assert find_places_to_check(replace(camera, residuals=near), image) == []
