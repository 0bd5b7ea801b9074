"""Run commands of lfrender on the small house, and check what they print."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

import lfcal
from lfrender.cli.main import main


def _run(*arguments):
    return CliRunner().invoke(
        main, [str(argument) for argument in arguments], catch_exceptions=False
    )


def _figures_of(*arguments):
    result = _run(*arguments, "--json")
    assert result.exit_code == 0, result.output
    # The object has the keys and types that are documented.
    msgspec.json.decode(result.stdout, type=main.commands[arguments[0]].callback.result)
    return json.loads(result.stdout)


def _assert_refused(result, *words):
    assert result.exit_code == 2, result.output
    assert result.stderr.count("\n") == 1
    assert all(word in result.stderr for word in words), result.stderr


@pytest.fixture(scope="session")
def run():
    """Runs a command; gives its exit code and output."""
    return _run


@pytest.fixture(scope="session")
def figures_of():
    """Runs a command that must succeed, and gives the figures that it prints with --json."""
    return _figures_of


@pytest.fixture(scope="session")
def assert_refused():
    """Checks that a command was refused with one line that has these words."""
    return _assert_refused


@pytest.fixture
def ask(house_files):
    """The words of a command on the flat of the house, with its camera."""
    return lambda command, *more: (
        command,
        house_files / "flat.png",
        "-c",
        house_files / "camera.json",
        *more,
    )


@pytest.fixture
def moved(house, tmp_path):
    """A camera file whose centres lie 5 px beside those of the flat."""
    camera = house.truth.calibration
    lattice = replace(camera.lattice, origin=camera.lattice.origin + np.array([4, 3]))
    replace(camera, lattice=lattice).save(tmp_path / "moved.json")
    return tmp_path / "moved.json"


@pytest.fixture
def raw_house(house_files, tmp_path):
    """The flat of the house seen through filters RGGB."""
    colour = lfcal.read_flat(house_files / "flat.png")
    raw = colour[:, :, 1].copy()
    raw[::2, ::2], raw[1::2, 1::2] = colour[::2, ::2, 0], colour[1::2, 1::2, 2]
    cv2.imwrite(str(tmp_path / "raw.png"), raw)
    return tmp_path / "raw.png"
