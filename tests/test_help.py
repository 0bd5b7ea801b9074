"""What `--help`, `--verbose` and the shell promise of the command lines."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys

import pytest
from click.testing import CliRunner

import data_synth.cli
import lfcal.cli.main
import lfrender.cli.main

PROGRAMS = {"lfcal": lfcal.cli.main.main, "lfrender": lfrender.cli.main.main}
COMMANDS = [(program, name) for program, group in PROGRAMS.items() for name in group.commands]


@pytest.mark.parametrize(("program", "name"), COMMANDS)
def test_each_help_ends_with_examples_that_the_command_understands(program, name):
    command = PROGRAMS[program].commands[name]
    shown = CliRunner().invoke(PROGRAMS[program], [name, "--help"]).output
    lines = [line for line in command.epilog.splitlines() if line.startswith("  ")]
    assert lines
    for line in lines:
        assert line in shown
        called, named, *arguments = shlex.split(line)
        assert (called, named) == (program, name)
        command.make_context(name, arguments)


def test_the_simulator_shows_examples_that_it_understands():
    shown = CliRunner().invoke(data_synth.cli.main, ["--help"]).output
    lines = [line.strip() for line in shown.splitlines() if line.strip().startswith("lfsynth ")]
    assert len(lines) == 3
    for line in lines:
        data_synth.cli.main.make_context("lfsynth", shlex.split(line)[1:])


@pytest.mark.parametrize(("program", "name"), [*COMMANDS, ("lfsynth", "")])
def test_each_command_can_be_quiet_verbose_or_read_by_programs(program, name):
    command = PROGRAMS[program].commands[name] if name else data_synth.cli.main
    assert {"--json", "--quiet", "--verbose"} <= {
        word for option in command.params for word in option.opts
    }


def test_the_simulator_is_quiet_or_verbose_as_asked(tmp_path):
    words = [
        "blank",
        "-o",
        str(tmp_path / "a"),
        "--size",
        "60x40",
        "--pitch",
        "20",
        "--samples",
        "1",
    ]
    quiet = CliRunner().invoke(data_synth.cli.main, [*words, "--quiet"])
    assert (quiet.exit_code, quiet.output) == (0, "")
    verbose = CliRunner().invoke(data_synth.cli.main, [*words, "--verbose", "--json"])
    assert [line.partition(":")[0] for line in verbose.stderr.splitlines()] == ["simulate", "write"]
    assert verbose.stdout.startswith("{")


def test_verbose_tells_each_stage_and_its_seconds(house_files, tmp_path):
    result = CliRunner().invoke(
        lfrender.cli.main.main,
        [
            "render",
            str(house_files / "flat.png"),
            "-c",
            str(house_files / "camera.json"),
            "--traditional",
            "--verbose",
            "-o",
            str(tmp_path / "small.png"),
            "--json",
        ],
    )
    assert result.exit_code == 0, result.output
    stages = dict(line.split(": ") for line in result.stderr.splitlines())
    assert set(stages) == {"read", "calibrate", "render", "write"}
    assert all(seconds.endswith(" s") and float(seconds[:-2]) >= 0 for seconds in stages.values())


@pytest.mark.parametrize(
    ("program", "begun", "offered"), [("lfrender", "re", "render"), ("lfcal", "cal", "calibrate")]
)
def test_the_shell_completes_commands(program, begun, offered):
    shell = {
        "COMP_WORDS": f"{program} {begun}",
        "COMP_CWORD": "1",
        f"_{program.upper()}_COMPLETE": "bash_complete",
    }
    code = (
        f"import {program}.cli.main, sys; sys.argv = ['{program}']; "
        f"{program}.cli.main.main(prog_name='{program}')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | shell, capture_output=True, text=True
    )
    assert f"plain,{offered}" in done.stdout


def test_a_command_that_fails_at_once_says_one_line(tmp_path):
    for _ in range(3):
        done = subprocess.run(
            [
                sys.executable,
                "-c",
                "from lfrender.cli.main import main; main()",
                "render",
                str(tmp_path / "no.png"),
                "-o",
                str(tmp_path / "x.tif"),
            ],
            capture_output=True,
            text=True,
        )
        assert done.returncode == 2
        assert len(done.stderr.splitlines()) == 1, done.stderr


@pytest.mark.parametrize("program", ["lfcal", "lfrender"])
def test_help_loads_neither_numpy_nor_numba(program):
    code = (
        f"import sys, {program}.cli.main; sys.exit(not sys.modules.keys().isdisjoint({{'numpy', "
        f"'numba', 'cv2'}}))"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
