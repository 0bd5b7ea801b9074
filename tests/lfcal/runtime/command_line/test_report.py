"""What command lines share: errors, stages, figures."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest
from click.testing import CliRunner

from lfcal import FlatError
from lfcal.runtime import compile_ahead as ahead
from lfcal.runtime.console import CommandGroup, Report


def program_raising(error):
    program = CommandGroup("tool")

    @program.command()
    def work():
        raise error

    return program


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (FlatError("flat.png: is\nempty"), "tool: flat.png: is empty"),
        (OSError(28, "No space left on device", "out.tif"), "tool: out.tif: No space left on device"),
        (MemoryError(), "tool: not enough memory for an image of this size"),
    ],
)
def test_user_errors_are_one_line_and_exit_code_2(error, line):
    result = CliRunner().invoke(program_raising(error), ["work"])
    assert result.exit_code == 2
    assert result.stderr == line + "\n"
    assert result.stdout == ""


def test_usage_errors_are_one_line_and_exit_code_2():
    for arguments in (["play"], ["work", "--loud"], ["work", "more"]):
        result = CliRunner().invoke(program_raising(None), arguments)
        assert result.exit_code == 2
        assert result.stderr.count("\n") == 1


def test_programming_errors_are_not_hidden():
    with pytest.raises(ZeroDivisionError):
        CliRunner().invoke(program_raising(ZeroDivisionError()), ["work"], catch_exceptions=False)


def test_json_report_is_one_object_without_nan(capsys):
    report = Report(as_json=True)
    with report.stage("read"):
        pass
    report.finish({"pitch": np.float64(23.25), "origin": np.array([1.0, np.nan]), "warnings": ["dark"]})
    out, err = capsys.readouterr()
    figures = json.loads(out)
    assert figures["pitch"] == 23.25
    assert figures["origin"] == [1.0, None]
    assert figures["warnings"] == ["dark"]
    assert 0 <= figures["seconds"]["read"] < 1
    assert err == ""


def test_text_report_puts_warnings_on_stderr_and_quiet_keeps_only_them(capsys):
    Report().finish({"pitch": 23.25, "warnings": ["dark"]})
    out, err = capsys.readouterr()
    assert "pitch" in out and "23.25" in out and "dark" not in out
    assert err == "warning: dark\n"
    Report(quiet=True).finish({"pitch": 23.25, "warnings": ["dark"]})
    out, err = capsys.readouterr()
    assert out == ""
    assert err == "warning: dark\n"


def test_stages_are_logged_only_on_demand(capsys):
    for options, lines in [({}, ""), ({"log_stages": True}, "work ...\n"), ({"log_stages": True, "as_json": True}, "")]:
        with Report(**options).stage("work"):
            pass
        assert capsys.readouterr().out == lines


def test_groups_of_figures_become_rows(capsys):
    Report().finish({"merit": {"all_in_focus": {"psnr": 21.84, "ssim": 0.8}}, "modes": {"telescopic": 0.25}})
    out = capsys.readouterr().out
    assert "merit, all in focus  psnr 21.84, ssim 0.8" in out
    assert "telescopic 0.25" in out


def test_compiling_is_announced_once_and_its_seconds_are_told_apart(capsys, monkeypatch):
    compiled = []
    monkeypatch.setattr(ahead, "is_compiled", lambda: bool(compiled))
    monkeypatch.setattr(ahead, "compile_once", lambda *_: compiled.append(time.sleep(0.2)) or 0)
    report = Report()
    for name in ("read", "work"):
        with report.stage(name):
            pass
    assert len(compiled) == 1
    assert capsys.readouterr().out.count("compiling kernels, once per installation") == 1
    assert report.compile_seconds >= 0.2 > sum(report.seconds.values())
