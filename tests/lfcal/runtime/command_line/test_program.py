"""What command lines share: errors of one line, files and patterns, stages, figures, progress on a
terminal.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time

import click
import numpy as np
import pytest
from click.testing import CliRunner

import lfcal
import lfcal.cli.main
import lfrender.cli.main
from lfcal import FlatError
from lfcal.runtime import command_line as cl
from lfcal.runtime import progress
from lfcal.runtime.compilation import compile_ahead

PROGRAMS = {"lfcal": lfcal.cli.main.main, "lfrender": lfrender.cli.main.main}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name in ("flat.png", "frame_1.png", "frame_2.png", "odd[1].png", "-dash.png", "white.png"):
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path


def program(error=None):
    """A program with two commands, one of which raises an error."""
    tool = cl.Program("tool", others=("other", "cut"))

    @cl.command("tool one flat.png")
    @click.argument("flat", type=cl.INPUT)
    @cl.option("--white", cl.INPUT, "A file.")
    @cl.option("--size", cl.Pair("WxH", "20x10"), "A size.")
    @cl.report_options(cl.Result)
    def one(report, given):
        if error is not None:
            raise error
        click.echo(f"{given.flat} {given.white} {given.size}")

    @cl.command("tool join a.png -o b.png")
    @click.argument("flat", type=cl.INPUT)
    @cl.option("-c --camera", cl.INPUT, "A file.")
    @cl.output_option("FILE", "A file.", replaces="camera")
    @cl.option("--page", cl.OutputPath(), "A page.")
    @cl.report_options(cl.Result)
    def join(report, given):
        click.echo("joined")

    @cl.command("tool many *.png")
    @cl.several_inputs("images", "IMAGE...")
    @cl.report_options(cl.Result)
    def many(report, given):
        click.echo(" ".join(map(str, given.images)))

    tool.add_command(one)
    tool.add_command(join)
    tool.add_command(many)
    return lambda *words: CliRunner().invoke(tool, words, catch_exceptions=False)


def test_a_pattern_that_the_shell_did_not_expand_stands_for_the_files_it_matches(folder):
    tool = program()
    assert tool("many", "frame_*.png", "flat.png").stdout == "frame_1.png frame_2.png flat.png\n"
    assert tool("one", "fl*.png", "--white", "w*.png").stdout == "flat.png white.png None\n"
    # A file may be called like a pattern.
    assert tool("many", "odd[1].png").stdout == "odd[1].png\n"
    assert (
        tool("one", "flat.png", "--white=~/white.png").stdout
        == f"flat.png {folder / 'white.png'} None\n"
    )
    assert tool("one", "flat.png", "--size", "30X07").stdout == "flat.png None (30, 7)\n"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("one", "fxxe.png"), "tool: fxxe.png: does not exist\n"),
        (("one", "-dash.png"), "-dash.png is taken for an option: write ./-dash.png"),
        (("one", "flat.png", "--white", "frame*"), "frame* stands for 2 files"),
        (("one",), "Missing argument 'FLAT'"),
        (("one", "flat.pgn"), "flat.pgn: does not exist; did you mean flat.png?"),
        (("one", "flat.tif"), "flat.tif: does not exist; did you mean flat.png?"),
        (
            ("one", "flat.png", "--white", "whit.png"),
            "whit.png: does not exist; did you mean white.png",
        ),
        (("many", "flat.png", "sunset.jpg"), "tool: sunset.jpg: does not exist\n"),
        (("one", "flat.png", "--whit", "white.png"), "'--white'?"),
        (("one", "flat.png", "--size", "30"), "must be WxH such as 20x10, got '30'"),
        (("cut", "flat.png"), "Did you mean 'other cut'?"),
        (("play",), "No such command 'play'"),
        (("one", "flat.png", "more"), "unexpected extra argument"),
    ],
)
def test_errors_of_usage_are_one_line_with_what_may_be_meant(folder, words, message):
    result = program()(*words)
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("-o", "new.html", "--page", "./new.html"), "--output and --page name the same output"),
        (("-o", "flat.png"), "flat.png: is an input of this command"),
        (("-o", "new.html", "--page", "white.png"), "white.png: is an input of this command"),
    ],
)
def test_outputs_have_different_names_and_replace_no_input(folder, words, message):
    tool = program()
    result = tool("join", "flat.png", "-c", "white.png", *words)
    assert (result.exit_code, result.stdout) == (2, "")
    assert message in result.stderr and result.stderr.count("\n") == 1
    # The option says that this input may be replaced.
    assert tool("join", "flat.png", "-c", "white.png", "-o", "white.png").stdout == "joined\n"


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (FlatError("flat.png: is\nempty"), "tool: flat.png: is empty"),
        (
            OSError(28, "No space left on device", "out.tif"),
            "tool: out.tif: No space left on device",
        ),
        (MemoryError(), "tool: not enough memory for an image of this size"),
    ],
)
def test_user_errors_are_one_line_and_exit_code_2(folder, error, line):
    result = program(error)("one", "flat.png")
    assert (result.exit_code, result.stdout, result.stderr) == (2, "", line + "\n")


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (FlatError("flat.png: is empty"), "flat"),
        (lfcal.CameraFileError("camera.json: is empty"), "camera_file"),
        (OSError(28, "No space left on device", "out.tif"), "system"),
        (MemoryError(), "memory"),
        (click.UsageError("--a needs --b"), "usage"),
    ],
)
def test_errors_are_objects_with_a_kind_and_the_same_text_for_programs(folder, error, kind):
    plain = program(error)("one", "flat.png")
    result = program(error)("one", "flat.png", "--json")
    assert (result.exit_code, result.stderr) == (2, plain.stderr)
    message = plain.stderr.strip().removeprefix("tool: ")
    failure = {"kind": kind, "message": message}
    assert json.loads(result.stdout) == {"version": 1, "error": failure}


@pytest.mark.parametrize("words", [("one", "--json"), ("play", "--json"), ("one", "no.png")])
def test_errors_of_usage_are_objects_too(folder, words):
    result = program()(*words, "--json")
    assert json.loads(result.stdout)["error"]["kind"] == "usage" and result.exit_code == 2


@pytest.mark.parametrize(
    ("program", "name"),
    [(program, name) for program, group in PROGRAMS.items() for name in group.commands],
)
def test_each_key_of_each_object_is_described_in_its_schema(program, name):
    result = PROGRAMS[program].commands[name].callback.result
    schema = cl.json_schema(result)["$defs"][result.__name__]
    assert {"version", "warnings", "seconds"} < set(schema["properties"])
    assert all(entry["description"] for entry in schema["properties"].values())


def test_ctrl_c_is_exit_code_130_and_programming_errors_are_not_hidden(folder):
    result = program(KeyboardInterrupt())("one", "flat.png")
    assert (result.exit_code, result.stderr) == (130, "\ninterrupted\n")
    with pytest.raises(ZeroDivisionError):
        program(ZeroDivisionError())("one", "flat.png")


def test_each_program_knows_the_commands_of_the_other():
    for name, other in (("lfcal", "lfrender"), ("lfrender", "lfcal")):
        assert PROGRAMS[name].others[0] == other
        assert set(PROGRAMS[name].others[1].split()) == set(PROGRAMS[other].commands)


def test_json_report_is_one_object_without_nan(capsys):
    report = cl.Report(as_json=True)
    with report.stage("read"):
        pass
    report.finish(
        {"pitch": np.float64(23.25), "origin": np.array([1.0, np.nan]), "warnings": ["dark"]}
    )
    out, err = capsys.readouterr()
    figures = json.loads(out)
    assert (figures["pitch"], figures["origin"], figures["warnings"]) == (
        23.25,
        [1.0, None],
        ["dark"],
    )
    assert 0 <= figures["seconds"]["read"] < 60
    assert err == ""


def test_text_report_puts_warnings_on_stderr_and_quiet_keeps_only_them(capsys):
    figures = {"pitch": 23.25, "warnings": ["dark"]}
    for quiet in (False, True):
        cl.Report(quiet=quiet).finish(figures, "The pitch is 23.25 px.")
        out, err = capsys.readouterr()
        assert out == ("" if quiet else "The pitch is 23.25 px.\n")
        assert err == "warning: dark\n"


def test_warnings_that_a_camera_file_holds_are_one_line_that_names_where_they_are_whole(capsys):
    long = "the flat is seen through colour filters, taken for GBRG: " + 20 * "red is a guess "
    stored = (long, "rims are blurred (by 7 px) " + 20 * "more than they should be ")
    for as_json in (False, True):
        report = cl.Report(as_json=as_json)
        report.camera_warnings("camera.json", stored)
        report.finish({"pitch": 15.4, "warnings": [*stored, "the lattice was moved"]})
        out, err = capsys.readouterr()
        if as_json:
            assert json.loads(out)["warnings"] == [*stored, "the lattice was moved"]
        else:
            assert err.splitlines() == [
                "warning: camera.json: the flat is seen through colour filters; rims are blurred "
                "('lfcal info camera.json' says more)",
                "warning: the lattice was moved",
            ]
    report = cl.Report()
    report.camera_warnings("camera.json", ("the lattice was stated, not measured",))
    report.finish({"pitch": 15.4, "warnings": ["the lattice was stated, not measured"]})
    assert capsys.readouterr().err == "warning: the lattice was stated, not measured\n"


def test_compiling_is_announced_once_and_its_seconds_are_told_apart(capsys, monkeypatch):
    compiled = []
    monkeypatch.setattr(compile_ahead, "is_compiled", lambda: bool(compiled))
    monkeypatch.setattr(
        compile_ahead, "compile_once", lambda *_: compiled.append(time.sleep(0.2)) or 0
    )
    report = cl.Report()
    for name in ("read", "work"):
        with report.stage(name):
            pass
    assert len(compiled) == 1
    assert capsys.readouterr().out.count("compiling kernels, once per installation") == 1
    assert report.compile_seconds >= 0.2 > sum(report.seconds.values())


WORK = """
import time
from lfcal.runtime.command_line import Report
report = Report(quiet={quiet})
with report.stage("render"), report.progress("tiles") as step:
    for done in range(4, 11):
        step(done, 10)
        if done == 7:
            time.sleep(0.3)
report.finish({{}}, "done")
"""


def on_a_terminal(code):
    """What a program writes to a terminal on stderr."""
    pty = pytest.importorskip("pty", reason="there are no pseudo-terminals on this system")
    ours, theirs = pty.openpty()
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "120"}
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=theirs, env=environment
    ) as run:
        os.close(theirs)
        shown = b""
        while True:
            try:
                piece = os.read(ours, 4096)
            except OSError:
                break
            if not piece:
                break
            shown += piece
        assert run.wait() == 0
    os.close(ours)
    return shown.decode()


def test_a_terminal_shows_stage_steps_share_and_time_unless_quiet():
    shown = on_a_terminal(WORK.format(quiet=False))
    for words in ("render", "tiles", "7/10", "70%", "0:00:00"):
        assert words in shown
    assert on_a_terminal(WORK.format(quiet=True)) == ""
    done = subprocess.run(
        [sys.executable, "-c", WORK.format(quiet=False)], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_texts_of_camera_files_cannot_steer_the_terminal(tmp_path):
    camera = lfcal.Calibration(
        lfcal.Lattice([40, 40], [[20, 0], [10, 17.3]], (400, 300), 9),
        warnings=("\x1b]0;title\x07\x1b[31mred \x9b2J \u202etxt.exe",),
        source="\x1b[2Jwhite",
    )
    camera.save(tmp_path / "camera.json")
    path = str(tmp_path / "camera.json")
    told = CliRunner().invoke(PROGRAMS["lfcal"], ["info", path])
    assert told.exit_code == 0
    for text in (told.stdout, told.stderr):
        assert not set(text) - set("\n") & {chr(k) for k in (*range(32), *range(127, 160), 0x202E)}
    assert r"\x1b[2Jwhite" in told.stdout and r"warning: \x1b]0;title\x07" in told.stderr
    figures = CliRunner().invoke(PROGRAMS["lfcal"], ["info", path, "--json"]).stdout
    assert "\x9b" not in figures and json.loads(figures)["warnings"] == list(camera.warnings)


@pytest.mark.parametrize(
    "text", ["x,y\n1e300,5\n3,9\n4,1\n", "i,j,x,y\n1,1,1e160,1\n1,2,1e160,2\n2,1,3e160,1\n"]
)
def test_numbers_beyond_any_flat_are_one_sentence_without_lines_of_libraries(tmp_path, text):
    (tmp_path / "centres.csv").write_text(text)
    command = [
        sys.executable,
        "-m",
        "lfcal",
        "info",
        str(tmp_path / "centres.csv"),
        "--size",
        "90x90",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.count("\n") == 1 and "numbers of at most 1e+09 are needed" in done.stderr


@pytest.mark.parametrize("words", [[], ["--json"]])
def test_compiling_is_told_where_nothing_is_a_terminal(monkeypatch, capsys, words):
    monkeypatch.setattr(compile_ahead, "is_compiled", lambda: False)
    monkeypatch.setattr(progress, "_LINE_EVERY", 0.1)

    def compile_once(processes, step):
        for done in range(4):
            time.sleep(0.06)
            step(done, 4)

    monkeypatch.setattr(compile_ahead, "compile_once", compile_once)
    cl.Report(as_json=bool(words)).compile_kernels()
    told = capsys.readouterr()
    assert "compiling kernels, once per installation" in (told.err if words else told.out)
    assert re.findall(r"compiling kernels: (\d) of 4 after 0 s", told.err) == ["1", "3"]
    cl.Report(quiet=True).compile_kernels()
    assert capsys.readouterr() == ("", "")
