"""One table of options: every command takes each of them, or refuses it with the reason."""

from __future__ import annotations

import json

import click
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

import lfcal
import lfcal.cli.main
from lfcal.runtime.command_line import Quantity
from lfrender.cli.main import main

COMMANDS = {
    "render": ("picture.png",),
    "analyze": ("depth.npz",),
    "refocus": ("focus.png", "--patch-size", "6"),
    "views": ("pair.png", "--stereo", "--scale", "4"),
    "view": ("page.html",),
    "report": ("report.html",),
    "batch": ("pictures",),
}
REFUSED = {
    ("analyze", "--depth"),
    ("batch", "--depth"),
    ("batch", "--page"),
    *((c, "--roi") for c in ("view", "report", "batch")),
}


@pytest.fixture(scope="module")
def files(house_files, tmp_path_factory):
    """A flat, one of a mosaic, one with two pages, a white image, a camera, a dark frame, and a
    depth map.
    """
    folder = tmp_path_factory.mktemp("options")
    flat = lfcal.read_flat(house_files / "flat.png")
    tifffile.imwrite(folder / "pages.tif", np.stack([flat, flat]), photometric="rgb")
    tifffile.imwrite(folder / "raw.tif", flat[..., 1].copy(), photometric="minisblack")
    tifffile.imwrite(folder / "dark.tif", np.zeros(flat.shape[:2], np.uint8))
    for name in ("flat.png", "white.png", "camera.json"):
        (folder / name).write_bytes((house_files / name).read_bytes())
    words = ["-c", str(folder / "camera.json"), "-o", str(folder / "depth.npz"), "--preset", "fast"]
    made = CliRunner().invoke(main, ["analyze", str(folder / "flat.png"), *words])
    assert made.exit_code == 0, made.output
    return folder


def run(files, folder, command, flat, options):
    """Run a command on a flat with options, each a list of words."""
    name, *more = COMMANDS[command]
    output = ["--export" if command == "view" else "-o", folder / name]
    given = [word for words in options for word in words]
    words = [command, files / flat, *output, *more, *given, "--preset", "fast", "--quiet"]
    return CliRunner().invoke(main, list(map(str, words)))


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_takes_every_option_or_says_why_not(files, tmp_path, command):
    camera = ["--camera", files / "camera.json"]
    dark = ["--dark", files / "dark.tif"]
    options = {
        "--roi": ["--roi", 100, 80, 300, 260],
        "--page": ["--page", 1],
        "--depth": ["--depth", files / "depth.npz"],
    }
    taken = [words for option, words in options.items() if (command, option) not in REFUSED]
    flat = "flat.png" if (command, "--page") in REFUSED else "pages.tif"
    for name, others in ((flat, [camera, dark, *taken]), ("raw.tif", [["--mosaic", "GRBG"]])):
        white = [] if camera in others else [["--white", files / "white.png"]]
        (tmp_path / name).mkdir()
        done = run(files, tmp_path / name, command, name, [*others, *white])
        assert done.exit_code == 0, done.output
        assert (tmp_path / name / COMMANDS[command][0]).exists()


@pytest.mark.parametrize(("command", "option"), sorted(REFUSED))
def test_options_that_make_no_sense_for_a_command_are_refused_with_the_reason(
    files, tmp_path, command, option
):
    value = {"--depth": [files / "depth.npz"], "--page": [1], "--roi": [100, 80, 300, 260]}
    camera = ["--camera", files / "camera.json"]
    done = run(files, tmp_path, command, "flat.png", [camera, [option, *value[option]]])
    assert done.exit_code == 2 and f"{option} makes no sense here: " in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_part_that_is_drawn_lies_on_the_whole_picture(files, tmp_path):
    """Of the picture in focus and of a view: the same pixels as in the whole one, at the place that
    the affine says.
    """
    roi = ["--roi", "100", "80", "300", "260"]
    for command in (["refocus", "--patch-size", "6"], ["views", "--stereo", "--scale", "5"]):
        for name, part in (("whole", []), ("part", roi)):
            words = [
                command[0],
                str(files / "flat.png"),
                "-c",
                str(files / "camera.json"),
                *command[1:],
                *part,
            ]
            done = CliRunner().invoke(
                main, [*words, "-o", str(tmp_path / f"{name}.tif"), "--preset", "fast"]
            )
            assert done.exit_code == 0, done.output
        pictures = {}
        affines = {}
        for name in ("whole", "part"):
            with tifffile.TiffFile(tmp_path / f"{name}.tif") as tiff:
                pictures[name] = tiff.asarray()
                affines[name] = np.array(json.loads(tiff.pages[0].description)["affine"])
        x, y = np.rint(
            (affines["part"][:, 2] - affines["whole"][:, 2]) / affines["whole"][0, 0]
        ).astype(int)
        height, width = pictures["part"].shape[:2]
        width = width if command[0] == "refocus" else width // 2
        assert width < pictures["whole"].shape[1] and height < pictures["whole"].shape[0]
        there = pictures["whole"][y : y + height, x : x + width]
        np.testing.assert_array_equal(pictures["part"][:, :width], there)


@pytest.mark.parametrize("program", [lfcal.cli.main.main, main], ids=["lfcal", "lfrender"])
def test_dark_frames_mean_the_same_in_all_commands(program):
    helps = {
        name: [option.help for option in command.params if "--dark" in option.opts]
        for name, command in program.commands.items()
    }
    texts = {name: texts[0] for name, texts in helps.items() if texts}
    assert set(texts.values()) == {"Dark frame that is subtracted from all flats and white images."}
    without = {"lattice", "info", "compare", "convert", "board", "demo", "warm", "lenslet"}
    assert set(program.commands) - set(texts) <= without


def test_an_option_of_another_command_names_it():
    done = CliRunner().invoke(main, ["render", "flat.png", "-o", "p.png", "--stack", "5"])
    assert done.exit_code == 2
    told = "No such option: --stack; it belongs to refocus. See 'lfrender render --help'."
    assert done.stderr == f"lfrender: {told}\n"
    done = CliRunner().invoke(main, ["render", "flat.png", "-o", "p.png", "--nothing"])
    assert "No such option" in done.stderr and "belongs" not in done.stderr


@pytest.mark.parametrize("place", [["30", "20"], ["30,20"], ["30;20"]])
def test_a_place_is_two_words_or_one_with_a_comma(house_files, tmp_path, place):
    words = [
        "refocus",
        str(house_files / "flat.png"),
        "-c",
        str(house_files / "camera.json"),
        "--preset",
        "fast",
    ]
    done = CliRunner().invoke(
        main, [*words, "--at", *place, "-o", str(tmp_path / "p.tif"), "--scale", "4"]
    )
    assert done.exit_code == 0, done.output
    with tifffile.TiffFile(tmp_path / "p.tif") as tiff:
        assert json.loads(tiff.pages.first.description)["at"] == [30, 20]


@pytest.mark.parametrize(
    ("before", "after", "text", "value"),
    [
        ("f *[/=]", "", "f/4", 4.0),
        ("f *[/=]", "", "2.8", 2.8),
        ("", "mm", "23mm", 23.0),
        ("", "[uµ]m", "5.5 µm", 5.5),
    ],
)
def test_numbers_stand_as_on_lenses_and_boards(before, after, text, value):
    assert Quantity(before, after).convert(text, None, None) == value
    for wrong in ("-3", "0", "f/", "4 inches"):
        with pytest.raises(click.BadParameter):
            Quantity(before, after).convert(wrong, None, None)
