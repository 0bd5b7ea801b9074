"""`lfrender volume`."""

from __future__ import annotations

import json
from unittest.mock import ANY

import cv2
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from data_synth.microscopy import Microscope, Specimen, trace_flat
from lfrender.cli.main import main

OPTICS = ["--na", 1.2, "--magnification", 60, "--medium-index", 1.35, "--pixel-size", 6.5]
SMALL = ["--planes", 5, "--steps", 3, "--voxels", 4]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with two flats, a white image and the camera."""
    folder = tmp_path_factory.mktemp("microscope")
    microscope = Microscope(lenses=(13, 13))
    (folder / "frames").mkdir()
    for number, depth in enumerate((3.0, 4.0)):
        capture = trace_flat(
            Specimen.shell(4.0, 1.5, (0, 0, depth)), microscope, samples=8, electrons=3000
        )
        tifffile.imwrite(folder / "frames" / f"frame{number}.tif", capture.flat)
    tifffile.imwrite(folder / "white.tif", capture.white)
    capture.calibration.save(folder / "camera.json")
    return folder


def _run(*words):
    return CliRunner().invoke(main, ["volume", *map(str, words)])


def test_a_flat_becomes_a_volume_in_micrometres(files, tmp_path):
    output = tmp_path / "volume.ome.tif"
    done = _run(
        files / "frames" / "frame0.tif",
        "-c",
        files / "camera.json",
        "-o",
        output,
        *OPTICS,
        *SMALL,
        "--depth-range",
        -9,
        9,
        "--json",
    )

    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["unit"] == "um" and found["shape"][0] == 5
    assert found["spacing"][0] == pytest.approx(4.5)
    assert found["steps"] == 3 and found["noise"] > 0
    assert tifffile.imread(output).shape == tuple(found["shape"])


def test_flats_of_a_folder_become_volumes_with_their_names(files, tmp_path):
    done = _run(
        files / "frames",
        "-c",
        files / "camera.json",
        "-o",
        tmp_path / "volumes",
        *SMALL,
        "--depth-range",
        -8,
        8,
    )

    assert done.exit_code == 0, done.output
    assert sorted(path.name for path in (tmp_path / "volumes").iterdir()) == [
        "frame0.ome.tif",
        "frame1.ome.tif",
    ]
    assert "in pixels of the flat" in done.output


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--depth-range", "-0.2", "0.2"], "native plane"),
        (["--na", "1.5"], "--na must be less than medium_index"),
        (["--preset", "fast"], "no depth map is analysed"),
    ],
)
def test_options_that_make_no_sense_are_refused(files, tmp_path, words, message):
    flat = files / "frames" / "frame0.tif"
    camera = files / "camera.json"
    done = _run(flat, "-c", camera, "-o", tmp_path / "volume.tif", *words)

    assert done.exit_code == 2
    assert message in " ".join(done.output.split())
    assert not (tmp_path / "volume.tif").exists()


def test_several_flats_become_a_time_lapse_of_the_part_in_one_file(files, tmp_path):
    words = ("-c", files / "camera.json", *SMALL, "--depth-range", -8, 8, "--interval", 2)
    output = tmp_path / "lapse.ome.tif"
    done = _run(files / "frames", *words, "--roi", 60, 60, 140, 120, "-o", output, "--json")

    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["frames"] == 2 and found["volumes"] == [str(output)]
    assert found["shape"][1:] == [pytest.approx(60 / found["spacing"][1], abs=2), ANY]
    with tifffile.TiffFile(output) as tiff:
        pixels = tifffile.xml2dict(tiff.ome_metadata)["OME"]["Image"]["Pixels"]
    assert (pixels["SizeT"], pixels["TimeIncrement"]) == (2, 2)


@pytest.fixture(scope="module")
def shells(tmp_path_factory):
    """The folder of a flat of two shells, and its white image."""
    specimen = Specimen.shell(8.0, 2.0, (0, 0, 1)) + Specimen.shell(3.0, 1.0, (8, 8, -4))
    capture = trace_flat(specimen, Microscope(lenses=(23, 23)), samples=8)
    folder = tmp_path_factory.mktemp("shells")
    tifffile.imwrite(folder / "flat.tif", capture.flat)
    return folder, capture.white


def _reconstruct(folder, white):
    tifffile.imwrite(folder / "white.tif", white)
    words = (folder / "flat.tif", "--white", folder / "white.tif", "-o", folder / "volume.tif")
    return _run(*words, *SMALL)


def test_the_white_image_of_another_camera_is_refused(shells):
    folder, white = shells
    height, width = white.shape
    wide = cv2.resize(white, None, fx=1.1, fy=1.1, interpolation=cv2.INTER_CUBIC)
    done = _reconstruct(folder, wide[:height, :width])
    assert done.exit_code == 2
    assert "white.tif: the pitch on the flat is -9" in " ".join(done.output.split())


def test_a_white_image_that_lies_beside_is_moved_onto_the_flat_with_a_warning(shells):
    folder, white = shells
    done = _reconstruct(folder, np.roll(white, (3, 0), (0, 1)))
    assert done.exit_code == 0
    assert "3.0 px beside" in done.output and "was moved onto" in done.output
