"""Files on a command line: patterns, several where one is wanted, misspelt names."""

from __future__ import annotations

from pathlib import Path

import click
import pytest
from click.testing import CliRunner

import lfcal.cli.main
import lfrender.cli.main
from lfcal import FlatError
from lfcal.runtime.console import CommandGroup, InputPath, several_inputs, single_input


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name in ("flat.png", "frame_1.png", "frame_2.png", "odd[1].png", "white.png"):
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path


@pytest.fixture
def tool():
    program = CommandGroup("tool")

    @program.command()
    @single_input("FLAT", "'tool many' takes several")
    @click.option("--white", type=InputPath())
    def one(flat, white):
        for path in filter(None, (flat, white)):
            if not path.exists():
                raise FlatError(f"{path}: cannot be read")
        click.echo(f"{flat} {white}")

    @program.command()
    @several_inputs("images", "IMAGE...")
    def many(images):
        click.echo(" ".join(str(image) for image in images))

    return lambda *words: CliRunner().invoke(program, words)


def test_a_pattern_that_the_shell_did_not_expand_stands_for_the_files_it_matches(folder, tool):
    assert tool("many", "frame_*.png", "flat.png").stdout == "frame_1.png frame_2.png flat.png\n"
    assert tool("one", "fl*.png", "--white", "w*.png").stdout == "flat.png white.png\n"
    # A file may be called like a pattern.
    assert tool("many", "odd[1].png").stdout == "odd[1].png\n"
    assert tool("one", "flat.png", "--white=~/white.png").stdout == f"flat.png {folder / 'white.png'}\n"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("one", "frame_*.png"), "FLAT is one file, got 2: frame_1.png, frame_2.png; 'tool many' takes several"),
        (("one", "flat.png", "white.png"), "got 2: flat.png, white.png; 'tool many'"),
        (("one", "flat.png", "--white", "frame*"), "frame* stands for 2 files"),
        (("one",), "Missing argument 'FLAT'"),
        (("one", "flat.pgn"), "flat.pgn: cannot be read; did you mean flat.png?"),
        (("one", "flat.tif"), "flat.tif: cannot be read; did you mean flat.png?"),
        (("one", "flat.png", "--white", "whit.png"), "whit.png: cannot be read; did you mean white.png?"),
        (("one", "flat.png", "--whit", "white.png"), "Did you mean '--white'?"),
    ],
)
def test_errors_suggest_what_may_be_meant(folder, tool, words, message):
    result = tool(*words)
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.count("\n") == 1


def test_a_name_without_similar_ones_is_refused_without_a_suggestion(folder, tool):
    assert tool("one", "sunset.jpg").stderr == "tool: sunset.jpg: cannot be read\n"


def test_commands_of_the_other_program_and_a_missing_command_are_recognised(folder):
    for program, words, message in (
        (lfrender.cli.main.main, ("calibrate", "flat.png"), "Did you mean 'lfcal calibrate'?"),
        (lfcal.cli.main.main, ("render", "flat.png"), "Did you mean 'lfrender render'?"),
        (lfrender.cli.main.main, ("flat.png",), "Did you mean 'lfrender render flat.png -o picture.tif'?"),
        (lfrender.cli.main.main, ("rendr", "flat.png"), "No such command 'rendr'"),
    ):
        result = CliRunner().invoke(program, words)
        assert result.exit_code == 2
        assert message in result.stderr


def test_each_program_knows_the_commands_of_the_other():
    programs = {"lfcal": lfcal.cli.main.main, "lfrender": lfrender.cli.main.main}
    for name, other in (("lfcal", "lfrender"), ("lfrender", "lfcal")):
        assert programs[name].other_programs == dict.fromkeys(programs[other].commands, other)


def test_an_image_as_camera_and_a_camera_as_depth_are_refused(house_files, tmp_path):
    flat, camera, output = (
        str(path) for path in (house_files / "flat.png", house_files / "camera.json", tmp_path / "x.png")
    )
    for words, message in (
        (("-c", str(house_files / "white.png")), "is an image, not a camera file"),
        (("--depth", camera), "is no depth map"),
    ):
        result = CliRunner().invoke(lfrender.cli.main.main, ["render", flat, "-o", output, *words])
        assert result.exit_code == 2
        assert message in result.stderr
    assert not Path(output).exists()


def test_a_white_image_as_flat_has_a_warning(house_files, tmp_path):
    output = str(tmp_path / "x.png")
    result = CliRunner().invoke(
        lfrender.cli.main.main, ["render", str(house_files / "white.png"), "--traditional", "-o", output]
    )
    assert result.exit_code == 0
    assert "this is a white image" in result.stderr
