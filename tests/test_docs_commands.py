"""Commands in README and documentation are parsed; those that take little time are run."""

from __future__ import annotations

import importlib.util
import pkgutil
import re
import shlex
import shutil
from dataclasses import replace
from fractions import Fraction
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import data_synth.cli
import lfcal.cli.main
import lfrender.cli.main

ROOT = Path(__file__).parents[1]
PROGRAMS = {
    "lfcal": lfcal.cli.main.main,
    "lfrender": lfrender.cli.main.main,
    "lfsynth": data_synth.cli.main,
}
PAGES = [
    ROOT / "README.md",
    *(p for p in sorted((ROOT / "docs").rglob("*.md")) if "built" not in str(p)),
]
# Commands that wait for a user, take long, or are run by other tests.
_NOT_RUN = {
    ("lfrender", "view"),
    ("lfrender", "live"),
    ("lfrender", "demo"),
    ("lfrender", "warm"),
    ("lfsynth", "house"),
}


def blocks(page, *languages):
    text = page.read_text(encoding="utf-8")
    return re.findall(rf"^```(?:{'|'.join(languages)})\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def _calls(lines):
    """Program and arguments of each line that calls one of the programs."""
    for line in lines:
        # Remove environment variables before a command, and shell operators after it.
        line = re.sub(r"^(?:[A-Z_]+=\S+ )+", "", re.split(r" && | \| ", line.removeprefix("$ "))[0])
        words = shlex.split(line, comments=True) if line.split(" ")[0] in PROGRAMS else []
        if len(words) > 1:
            yield words[0], words[1:]


def _without_blocks(page):
    return re.sub(
        r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE
    )


def commands(page):
    """The commands in blocks of code."""
    lines = [line for block in blocks(page, "sh", "console") for line in block.splitlines()]
    return list(
        _calls([*lines, *re.findall(r"^    (\w+ .*)$", _without_blocks(page), re.MULTILINE)])
    )


def mentions(page):
    """The commands in the text, which may lack arguments."""
    return list(
        _calls(re.findall(r"`((?:lfcal|lfrender|lfsynth) \w+ [^`]+)`", _without_blocks(page)))
    )


def _params(calls):
    return [
        pytest.param(program, words, id=f"{page.stem}: {program} {' '.join(words)}"[:90])
        for page in PAGES
        for program, words in calls(page)
    ]


@pytest.mark.parametrize(("program", "words"), _params(commands))
def test_a_command_in_the_documentation_is_understood(program, words):
    # N on a page stands for a number that the reader chooses.
    words = ["3" if word == "N" else word for word in words]
    if program == "lfsynth":
        PROGRAMS[program].make_context(program, words)
        return
    name, *arguments = words
    PROGRAMS[program].commands[name].make_context(name, arguments)


@pytest.mark.parametrize(("program", "words"), _params(mentions))
def test_a_command_in_the_text_has_the_options_that_are_named(program, words):
    group = PROGRAMS[program]
    known = [
        o
        for p in (group if program == "lfsynth" else group.commands[words[0]]).params
        for o in p.opts
    ]
    assert [
        word for word in words if re.match(r"--?[a-z]", word) and word not in [*known, "--help"]
    ] == []


def printed_after(page, command):
    """The output of a command on the page: the lines after it in a console block."""
    text = (ROOT / page).read_text(encoding="utf-8")
    found = re.search(rf"^\$ {re.escape(command)}\n((?:[^$`].*\n)*)", text, re.MULTILINE)
    return found[1] if found else ""


def mask(text):
    """A text without its numbers, which differ between captures."""
    return re.sub(r"\d[\d,.]*(?=\D)", "N", text)


@pytest.fixture(scope="session")
def printed_capture(tmp_path_factory):
    """The folder of a capture that is large enough for the sentences on the pages."""
    from data_synth import SCENES, Camera, simulate

    camera = Camera.design(size=(520, 400), pitch=20.3, lattice="hex", rotation=1.3)
    folder = tmp_path_factory.mktemp("printed")
    simulate(SCENES["house"](camera), camera, samples=16, seed=4).save(folder)
    return folder


@pytest.fixture
def folder(printed_capture, tmp_path, monkeypatch):
    """A folder with a small capture, as `lfsynth house -o capture` makes it."""
    (tmp_path / "capture").mkdir()
    for name in ("flat.png", "white.png"):
        shutil.copy(printed_capture / name, tmp_path / "capture")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def prepared(house, tmp_path_factory):
    """A folder with files of all names that the pages use, all of one small capture."""
    import tifffile

    import lfcal
    import lfrender
    from lfcal.camera_files.read_write import convert
    from lfrender.sequence.film_file import FilmFile

    folder = tmp_path_factory.mktemp("prepared")
    flat = house.flat
    white = house.white
    camera = replace(house.truth.calibration, optics=lfcal.Optics(50, 58, 0.7, 0.0055))
    for name in (
        "flat.png",
        "other.png",
        "frames/f0.png",
        "frames/f1.png",
        "sample.tif",
        "scan.tif",
        "BIG.tif",
    ):
        (folder / name).parent.mkdir(exist_ok=True)
        lfrender.write_picture(folder / name, flat)
    for name in ("white.png", "white.tif", "array/white.png", "shoot/white.png"):
        (folder / name).parent.mkdir(exist_ok=True)
        lfrender.write_picture(folder / name, white)
    camera.save(folder / "camera.json")
    camera.save(folder / "array/camera.json")
    camera.optics.save(folder / "optics.json")
    convert(camera, folder / "calibration.xml")
    lfrender.analyze(flat, camera).save(folder / "depth.npz")
    for name in ("stack.tif", "recording.tif"):
        tifffile.imwrite(folder / name, np.stack([flat, flat]), photometric="rgb")
    if importlib.util.find_spec("av"):
        with FilmFile(folder / "film.mkv", Fraction(25)) as film:
            film.add(flat)
            film.add(flat)
    if importlib.util.find_spec("zarr"):
        import zarr

        zarr.save(str(folder / "BIG.zarr"), flat)
    return folder


WHOLE_PAGES = ["README.md", "docs/start.md", "docs/refocus.md"]


def _single_commands():
    """All other commands, once each, except those that start workers or take long."""
    known = [call for page in WHOLE_PAGES for call in commands(ROOT / page)]
    for page in PAGES:
        for program, words in commands(page):
            long = (program, words[0]) in {*_NOT_RUN, ("lfcal", "metric")} - {("lfrender", "view")}
            if (
                long
                or {"--workers", "--scheduler"} & set(words)
                or program == "lfsynth"
                or (program, words) in known
            ):
                continue
            known.append((program, words))
            yield pytest.param(program, words, id=f"{page.stem}: {program} {' '.join(words)}"[:90])


@pytest.mark.parametrize(("program", "words"), list(_single_commands()))
def test_a_command_of_the_documentation_runs(program, words, prepared, tmp_path, monkeypatch):
    folder = tmp_path / "work"
    shutil.copytree(prepared, folder)
    monkeypatch.chdir(folder)
    # Replace values for the capture of the page by values for the small capture.
    words = [
        {"33": "6", "12.5": "6", "15.4": "20.3", "7x7": "2x2"}.get(word, word) for word in words
    ]
    if words[0] == "view" and "--export" not in words:
        words += ["--export", "page"]
    if words[0] == "volume":
        words += ["--steps", "1"]
    for word, package in ((".zarr", "zarr"), ("film", "av"), (".mp4", "av")):
        if any(word in one for one in words):
            pytest.importorskip(package)
    result = CliRunner().invoke(PROGRAMS[program], words, catch_exceptions=False)
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize("page", WHOLE_PAGES)
def test_commands_and_code_of_a_page_run(page, folder):
    for program, words in commands(ROOT / page):
        if (program, words[0]) in _NOT_RUN and "--export" not in words:
            continue
        # The capture is smaller than that of the page.
        words = ["200" if word == "550" else word for word in words]
        result = CliRunner().invoke(PROGRAMS[program], words, catch_exceptions=False)
        assert result.exit_code == 0, f"{program} {' '.join(words)}: {result.output}"
        if "-o" in words:
            made = folder / words[words.index("-o") + 1]
            assert made.exists() or list(folder.glob(f"{made.stem}*")), f"{made.name} is not there"
        output = printed_after(page, f"{program} {' '.join(words)}")
        printed = re.sub(
            r"^compiling kernels.*\n| \(after .* of compiling.*?\)",
            "",
            result.output,
            flags=re.MULTILINE,
        )
        assert not output or mask(printed) == mask(output)
    for code in blocks(ROOT / page, "python"):
        exec(compile(code, page, "exec"), {})


@pytest.mark.parametrize(
    "page", [p for p in PAGES if blocks(p, "python")], ids=lambda page: page.stem
)
def test_python_of_a_page_names_what_there_is(page):
    for code in blocks(page, "python"):
        compile(code, page.name, "exec")
        for package, name in re.findall(r"\b(lfcal|lfrender)\.((?:data\.)?\w+)", code):
            assert pkgutil.resolve_name(f"{package}.{name}")
        for module, names in re.findall(
            r"^from ((?:lfcal|lfrender|data_synth)[\w.]*) import ([\w, ]*\w)", code, re.MULTILINE
        ):
            assert all(hasattr(import_module(module), name) for name in names.split(", "))
