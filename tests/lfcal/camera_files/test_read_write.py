"""Any lattice is written and read again in every format that can hold it."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import lfcal
from lfcal.camera_files.read_write import convert
from lfcal.cli.main import main

_SIZE = (640, 480)
_HEXAGON = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])


def _largest_difference(a, b):
    assert len(a.lattice) == len(b.lattice)
    return lfcal.compare(a, b).max


_ANY = {
    "pitch": st.floats(6, 120),
    "degrees": st.floats(-90, 90),
    "x": st.floats(-500, 900),
    "y": st.floats(-500, 900),
}


@pytest.mark.parametrize("suffix", [".xml", ".csv", ".json"])
@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=40
)
@given(
    shape=st.sampled_from([np.eye(2), _HEXAGON, [[1, 0], [0, 1.3]], [[1, 0], [0.2, 1.0]]]), **_ANY
)
def test_any_lattice_is_read_again_to_a_thousandth_of_a_pixel(
    make_camera, tmp_path, suffix, shape, pitch, degrees, x, y
):
    camera = make_camera(shape, pitch, degrees, x=x, y=y)
    convert(camera, tmp_path / f"camera{suffix}")
    again = lfcal.load(tmp_path / f"camera{suffix}", _SIZE)
    assert lfcal.compare(camera, again).max < 1e-3
    if suffix != ".csv":
        assert again.lattice.radius == pytest.approx(camera.lattice.radius, abs=1e-6)


def _run(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments], catch_exceptions=False)


def test_command_asks_for_the_size_that_the_file_does_not_say(make_camera, tmp_path):
    camera = make_camera(_HEXAGON, 40, 2)
    convert(camera, tmp_path / "camera.xml")
    refused = _run("info", tmp_path / "camera.xml")
    assert refused.exit_code == 2 and "--size WxH" in refused.stderr
    assert _run("info", tmp_path / "camera.xml", "--size", "640").exit_code == 2
    cv2.imwrite(str(tmp_path / "flat.png"), np.zeros(_SIZE[::-1], np.uint8))
    for option in (("--size", "640x480"), ("--image", tmp_path / "flat.png")):
        result = _run("info", tmp_path / "camera.xml", *option, "--json")
        assert json.loads(result.stdout)["pitch"] == pytest.approx(40)


def test_command_converts_to_every_format_and_back(make_camera, tmp_path):
    camera = make_camera(_HEXAGON, 40, 2)
    camera.save(tmp_path / "a.json")
    for suffix in ("xml", "cfg", "csv"):
        assert _run("convert", tmp_path / "a.json", "-o", tmp_path / f"b.{suffix}").exit_code == 0
        back = _run(
            "convert", tmp_path / f"b.{suffix}", "-o", tmp_path / "c.json", "--size", "640x480"
        )
        assert back.exit_code == 0, back.output
        assert _largest_difference(camera, lfcal.load(tmp_path / "c.json")) < 1e-3
    assert _run("convert", tmp_path / "a.json", "-o", tmp_path / "b.txt").exit_code == 2
