"""The command line of the simulator."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from data_synth import SCENES, load_capture, simulator
from data_synth.cli import main


def run(*args: str):
    return CliRunner().invoke(main, list(args))


def test_simulates_with_all_options(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    options = [
        "--size",
        "120x100",
        "--pitch",
        "20",
        "--lattice",
        "square",
        "--rotation",
        "3",
        "--samples",
        "2",
    ]
    options += [
        "--noise",
        "9000,5",
        "--bits",
        "16",
        "--linear",
        "--seed",
        "4",
        "--types",
        "3",
        "--json",
    ]
    result = run("plane", "-o", str(folder), *options)
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert report["lenses"] > 20
    capture = load_capture(folder)
    assert capture.flat.shape == (100, 120, 3)
    assert capture.flat.dtype == "uint16"
    assert capture.camera.pitch == pytest.approx(20)
    assert len(capture.camera.microlens_focal_lengths) == 3
    assert capture.recipe["noise"] == [9000, 5]
    assert capture.recipe["seed"] == 4
    assert not capture.recipe["gamma"]


def test_lists_every_scene() -> None:
    result = run("--list")
    assert result.exit_code == 0
    assert [line.split()[0] for line in result.stdout.splitlines()] == [*SCENES, "board"]


@pytest.mark.parametrize(
    "args",
    [
        ["castle", "-o", "OUT"],
        ["plane"],
        ["plane", "-o", "OUT", "--size", "big"],
        ["plane", "-o", "OUT", "--size", "0x10"],
        ["plane", "-o", "OUT", "--pitch", "nan"],
        ["plane", "-o", "OUT", "--pitch", "-3"],
        ["plane", "-o", "OUT", "--noise", "0,1"],
        ["plane", "-o", "OUT", "--samples", "0"],
        ["plane", "-o", "OUT", "--seed", "-1"],
        ["plane", "-o", "OUT", "--bits", "12"],
        ["plane", "-o", "OUT", "--lattice", "octagonal"],
    ],
)
def test_bad_input_is_one_line_and_code_2(args: list[str], tmp_path: Path) -> None:
    result = run(*[str(tmp_path / "out") if a == "OUT" else a for a in args])
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.startswith("lfsynth: ")
    assert len(result.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_place_where_nothing_can_be_written_is_refused_before_the_simulation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setattr(simulator, "simulate", lambda *_, **__: pytest.fail("simulated"))
    result = run("blank", "-o", str(tmp_path / "file" / "capture"))
    assert result.exit_code == 2 and len(result.stderr.splitlines()) == 1


def test_output_that_cannot_be_a_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = run("blank", "-o", str(tmp_path / "file"), "--size", "40x40", "--samples", "1")
    assert result.exit_code == 2
    assert len(result.stderr.strip().splitlines()) == 1
