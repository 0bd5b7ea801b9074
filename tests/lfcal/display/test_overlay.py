"""The picture of a calibration over a flat."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import lfcal
from lfcal.cli.main import main
from lfcal.display.settings import STYLE
from lfcal.gain.defects import Defects


@pytest.fixture(scope="module")
def white(whites):
    basis = whites.turned(whites.HEXAGON, 20.3, 3)
    image, origin = whites.white_image(basis, (700, 500))
    return image, lfcal.Calibration(lfcal.Lattice(origin, basis, (700, 500), 9.0))


def _circle_pixels(picture):
    return (np.abs(picture.astype(int) - STYLE.circle).max(-1) < 40).sum()


def test_circles_are_drawn_in_all_five_crops(white):
    image, camera = white
    picture = lfcal.show(camera, image)
    assert picture.dtype == np.uint8 and picture.shape[2] == 3
    for x in (0, picture.shape[1] - STYLE.panel):
        for y in (0, picture.shape[0] - STYLE.panel):
            assert _circle_pixels(picture[y : y + STYLE.panel, x : x + STYLE.panel]) > 500


def test_picture_depends_on_lattice_and_flat(white):
    image, camera = white
    lattice = camera.lattice
    moved = lfcal.Calibration(lfcal.Lattice(lattice.origin + 3, lattice.basis, (700, 500), 9.0))
    pictures = [lfcal.show(camera, image), lfcal.show(moved, image), lfcal.show(camera, image[::-1])]
    assert all((pictures[0] != other).mean() > 0.01 for other in pictures[1:])


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("pitch", [6.0, 150.0])
def test_any_pitch_and_pixel_type_is_drawn(whites, kind, pitch):
    image, origin = whites.white_image(whites.turned(whites.SQUARE, pitch, 1), (620, 400))
    camera = lfcal.Calibration(lfcal.Lattice(origin, np.eye(2) * pitch, (620, 400), 0.45 * pitch))
    flat = (image / 65535 * (1 if kind is np.float32 else np.iinfo(kind).max)).astype(kind)
    assert _circle_pixels(lfcal.show(camera, np.repeat(flat[..., None], 3, axis=2))) > 500


def test_image_of_another_size_is_refused(white):
    with pytest.raises(lfcal.FlatError, match="700 x 500"):
        lfcal.show(white[1], white[0][:-1])


def test_command_writes_the_picture(white, tmp_path):
    image, camera = white
    cv2.imwrite(str(tmp_path / "flat.png"), image)
    camera.save(tmp_path / "camera.json")
    arguments = ["show", str(tmp_path / "camera.json"), "--image", str(tmp_path / "flat.png"), "--json"]
    result = CliRunner().invoke(main, [*arguments, "-o", str(tmp_path / "show.png")], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["pitch"] == pytest.approx(20.3)
    written = cv2.imread(str(tmp_path / "show.png"))
    np.testing.assert_array_equal(written[..., ::-1], lfcal.show(camera, image))
    refused = CliRunner().invoke(main, [*arguments, "-o", str(tmp_path / "show.txt")])
    assert refused.exit_code == 2


def test_circles_of_each_lens_type_have_their_own_colour(white):
    image, camera = white
    types = lfcal.LensTypes([[0, 1, 2], [2, 0, 1], [1, 2, 0]], True)
    picture = lfcal.show(replace(camera, lens_types=types), image).astype(int)
    counts = [(np.abs(picture - colour).max(-1) < 40).sum() for colour in STYLE.types[:3]]
    assert min(counts) > 500
    assert (np.abs(picture - STYLE.types[3]).max(-1) < 40).sum() < 50


def test_unlit_lens_is_crossed_out_at_its_centre(white):
    image, camera = white
    lattice = camera.lattice
    near = np.argmin(np.hypot(*(lattice.centres() - (349.5, 249.5)).T))
    missing = replace(camera, defects=Defects(lenses=lattice.indices()[[near]].astype(np.int32)))
    plain, crossed = lfcal.show(camera, image), lfcal.show(missing, image)
    pink = (np.abs(crossed.astype(int) - STYLE.defect).max(-1) < 60) & (plain != crossed).any(-1)
    rows, columns = np.nonzero(pink)
    assert len(rows) > 60
    # Arms of the length of the usable radius, 3 or 4 times enlarged, in the centre panel.
    assert 2 * 9.0 * 2 < np.ptp(columns) < 2 * 9.0 * 4 and 2 * 9.0 * 2 < np.ptp(rows) < 2 * 9.0 * 4
