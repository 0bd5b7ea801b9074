"""Progress on a terminal, and none without one."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

WORK = """
import time
from lfcal.runtime.console import Report
report = Report(quiet={quiet})
with report.stage("render"), report.counted_progress("tiles") as step:
    for done in range(4, 11):
        step(done, 10)
        if done == 7:
            time.sleep(0.3)
report.finish({{}})
"""


def on_a_terminal(code):
    """What a program writes to a terminal on stderr."""
    pty = pytest.importorskip("pty", reason="there are no pseudo-terminals on this system")
    ours, theirs = pty.openpty()
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "120"}
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=theirs, env=environment) as run:
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


def test_a_bar_shows_stage_steps_rate_and_remaining_time():
    shown = on_a_terminal(WORK.format(quiet=False))
    assert "render, tiles" in shown
    # Seven of ten, of which three were done before.
    assert "7/10" in shown
    assert "a second" in shown
    assert " s left" in shown


def test_nothing_is_shown_when_quiet_or_without_a_terminal():
    assert on_a_terminal(WORK.format(quiet=True)) == ""
    done = subprocess.run([sys.executable, "-c", WORK.format(quiet=False)], capture_output=True, text=True)
    assert done.returncode == 0
    assert done.stderr == ""
