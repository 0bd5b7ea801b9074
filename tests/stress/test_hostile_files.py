"""Files that somebody made to do harm end in one sentence, at once."""

from __future__ import annotations

import json
import os
import zipfile

import numpy as np
import pytest
from click.testing import CliRunner

import lfcal
import lfrender
from lfcal.camera_files.read_write import convert
from lfcal.cli.main import main
from lfcal.runtime.arrays import encode_array
from lfrender.data.depth_file import DepthFileError
from lfrender.data.depth_map import DepthMap


@pytest.fixture(scope="module")
def fields():
    """The fields of a camera file that holds light of all kinds."""
    sample = lfrender.data.house(size=(400, 300), samples=2)
    return lfcal.calibrate(sample.white, kind="white").to_dict()


def write(folder, fields):
    path = folder / "camera.json"
    path.write_text(json.dumps(fields))
    return path


def test_light_beyond_any_measured_is_refused_with_the_name_of_its_field(fields, tmp_path):
    lfcal.load(write(tmp_path, fields))
    vignetting = {**fields["vignetting"], "profile": [1e30] * len(fields["vignetting"]["profile"])}
    with pytest.raises(
        lfcal.CameraFileError, match=r"field vignetting\.profile\[0\]: Expected `float` <= 10"
    ):
        lfcal.load(write(tmp_path, {**fields, "vignetting": vignetting}))
    for name, value in (
        ("profile", encode_array(np.full(20, 1e30, "<f4"))),
        ("own", encode_array(np.full(20, 6e4, "<f2"))),
        ("level", [1e5]),
        ("shade", [[1e9]] * 5),
        ("rim", [[1e9]]),
        ("cut", [1e12, 0, 0, 1, 1]),
        ("dark", 1e9),
    ):
        changed = {**fields, "gain_map": {**fields["gain_map"], name: value}}
        with pytest.raises(lfcal.CameraFileError, match=rf"field gain_map\.{name}[:\[]"):
            lfcal.load(write(tmp_path, changed))


@pytest.mark.parametrize("corner", ["LeftTop", "RightTop", "LeftBottom", "RightBottom"])
def test_a_corner_that_does_not_fit_the_others_is_refused(tmp_path, corner):
    camera = lfcal.Calibration(lfcal.Lattice([40, 40], [[70, 0], [35, 60.62]], (4000, 3000), 35))
    path = tmp_path / "camera.cfg"
    convert(camera, path)
    assert lfcal.load(path).lattice.pitch == pytest.approx(70, abs=0.1)
    lines = path.read_text().splitlines()
    path.write_text(
        "\n".join(f"{line.split(':')[0]}: 0" if line.startswith(corner) else line for line in lines)
    )
    with pytest.raises(
        lfcal.CameraFileError, match="the corner centres do not fit a diameter of 70 px"
    ):
        lfcal.load(path)


def test_elements_that_are_nested_too_deeply_are_refused(tmp_path):
    (tmp_path / "camera.xml").write_text("<a>" * 50_000 + "</a>" * 50_000)
    with pytest.raises(
        lfcal.CameraFileError, match=r"camera\.xml: not a camera file: its elements are nested"
    ):
        lfcal.load(tmp_path / "camera.xml", (100, 100))


def test_depth_files_that_unpack_to_gigabytes_are_refused_by_their_header(tmp_path):
    path = tmp_path / "depth.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("surface.npy", "w") as stream,
    ):
        for _ in range(200):
            stream.write(bytes(1 << 20))
    with pytest.raises(DepthFileError, match="would unpack to 210 MB"):
        DepthMap.load(path)


def test_packed_blocks_of_camera_files_do_not_unpack_to_gigabytes(fields, tmp_path):
    block = encode_array(np.zeros(300 << 20, np.uint8))
    with pytest.raises(lfcal.CameraFileError, match="a packed block has more than 268 MB"):
        lfcal.load(write(tmp_path, {**fields, "gain_map": {**fields["gain_map"], "own": block}}))
    short = fields["gain_map"]["profile"][:40]
    with pytest.raises(lfcal.CameraFileError, match="a packed block is cut off"):
        lfcal.load(
            write(tmp_path, {**fields, "gain_map": {**fields["gain_map"], "profile": short}})
        )


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
@pytest.mark.parametrize("kind", ["device", "pipe"])
def test_devices_and_pipes_are_no_camera_depth_or_optics_files(tmp_path, kind):
    path = tmp_path / "camera.npz"
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    for load in (lfcal.load, lfcal.Optics.load, DepthMap.load):
        with pytest.raises(lfcal.LightFieldError, match="is no regular file"):
            load(path)
    run = CliRunner().invoke(main, ["info", str(path)])
    assert (
        run.exit_code == 2 and "is a device or a pipe; give a file, or - for a pipe" in run.stderr
    )


def test_camera_files_larger_than_any_are_refused_before_they_are_read(tmp_path):
    path = tmp_path / "camera.json"
    with path.open("wb") as stream:
        stream.truncate(1 << 32)
    with pytest.raises(lfcal.CameraFileError, match="has 4,295 MB, more than any such file"):
        lfcal.load(path)
