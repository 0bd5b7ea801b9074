"""What the README shows runs as it stands."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

import lfcal.cli.main
import lfrender.cli.main

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
PROGRAMS = {"lfcal": lfcal.cli.main.main, "lfrender": lfrender.cli.main.main}


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


@pytest.fixture
def folder(house_files, tmp_path, monkeypatch):
    for name in ("flat.png", "white.png"):
        shutil.copy(house_files / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_commands_of_the_readme(folder):
    lines = [shlex.split(line, comments=True) for line in "".join(blocks("sh")).splitlines()]
    commands = [line for line in lines if line and line[0] in PROGRAMS and line[1] != "demo"]
    assert len(commands) >= 7
    for program, *arguments in commands:
        result = CliRunner().invoke(PROGRAMS[program], arguments, catch_exceptions=False)
        assert result.exit_code == 0, f"{program} {' '.join(arguments)}: {result.output}"
        if "-o" in arguments:
            assert (folder / arguments[arguments.index("-o") + 1]).stat().st_size > 0


def test_python_of_the_readme(folder):
    (code,) = blocks("python")
    exec(compile(code, "README.md", "exec"), {})
    assert (folder / "picture.tif").exists()
