"""`lfrender volume`."""

from __future__ import annotations

import json

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


def test_several_flats_want_a_folder(files, tmp_path):
    done = _run(files / "frames", "-c", files / "camera.json", "-o", tmp_path / "volume.tif")

    assert done.exit_code == 2
    assert "give a folder" in " ".join(done.output.split())


def test_the_white_image_of_another_camera_is_refused(tmp_path):
    specimen = Specimen.shell(8.0, 2.0, (0, 0, 1)) + Specimen.shell(3.0, 1.0, (8, 8, -4))
    capture = trace_flat(specimen, Microscope(lenses=(23, 23)), samples=8)
    tifffile.imwrite(tmp_path / "flat.tif", capture.flat)
    tifffile.imwrite(tmp_path / "white.tif", np.roll(capture.white, (7, 7), (0, 1)))
    done = _run(
        tmp_path / "flat.tif",
        "--white",
        tmp_path / "white.tif",
        "-o",
        tmp_path / "volume.tif",
        *SMALL,
    )

    assert done.exit_code != 0
    assert "another camera" in " ".join(done.output.split())
