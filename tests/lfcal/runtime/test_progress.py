"""`progress=` of long functions: True shows a bar or lines, a function is called at each step."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

import lfcal
import lfrender
from lfcal.runtime import progress
from lfcal.runtime.compilation import compile_ahead

CAMERA = lfcal.Calibration(lfcal.Lattice([10, 10], [[20, 0], [0, 20]], (200, 160), 9))
FLAT = np.random.default_rng(0).integers(0, 255, (160, 200), np.uint8)


def white():
    y, x = np.mgrid[:240, :300]
    distance = np.hypot((x - 9) % 20 - 10, (y - 6) % 20 - 10)
    return 200 * np.clip(9.5 - distance, 0, 1) + np.random.default_rng(0).normal(20, 2, x.shape)


def in_tiles(folder, step):
    lfrender.write_picture(folder / "flat.tif", FLAT)
    with lfcal.open_flat(folder / "flat.tif") as source:
        depth = lfrender.analyze_large(source, CAMERA, "fast", progress=step)
        return lfrender.render_large(
            source, folder / "picture.tif", CAMERA, depth, scale=6, progress=step
        )


def frames(folder, step):
    for name in ("a.tif", "b.tif"):
        lfrender.write_picture(folder / name, FLAT)
    found = lfrender.open_frames([folder])
    return list(lfrender.render_frames(found, folder / "out", CAMERA, preset="fast", progress=step))


@pytest.mark.parametrize(
    "work",
    [
        lambda _, step: lfcal.calibrate(white(), progress=step),
        lambda _, step: lfrender.analyze(FLAT, CAMERA, "fast", progress=step),
        lambda _, step: lfrender.render(FLAT, CAMERA, patch_size=5, progress=step),
        lambda _, step: lfrender.reconstruct_volume(
            FLAT, CAMERA, depth_range=(-4, 4), planes=3, steps=2, progress=step
        ),
        in_tiles,
        frames,
    ],
    ids=["calibrate", "analyze", "render", "volume", "large", "frames"],
)
def test_a_function_is_called_until_all_steps_are_done(tmp_path, work):
    steps = []
    work(tmp_path, lambda done, count: steps.append((done, count)))
    assert steps and steps[-1][0] == steps[-1][1]
    assert all(0 < done <= count for done, count in steps)


def test_what_is_no_progress_is_named():
    with pytest.raises(TypeError, match="progress must be True, False or a function, got str"):
        lfrender.analyze(FLAT, CAMERA, "fast", progress="bar")


def test_true_prints_lines_at_times_where_nothing_is_a_terminal(monkeypatch, capsys):
    monkeypatch.setattr(compile_ahead, "is_compiled", lambda: True)
    monkeypatch.setattr(progress, "_LINE_EVERY", 0.0)
    lfrender.render(FLAT, CAMERA, patch_size=5, progress=True)
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.splitlines() == ["render: 1 of 2 after 0 s", "render: 2 of 2 after 0 s"]


def test_true_announces_that_kernels_are_compiled_and_compiles_them_in_another_process(
    monkeypatch, capsys
):
    started = []
    monkeypatch.setattr(compile_ahead, "is_compiled", lambda: False)
    monkeypatch.setattr(progress.subprocess, "run", lambda words, **_: started.append(words))
    lfrender.render(FLAT, CAMERA, patch_size=5, progress=True)
    assert started == [[sys.executable, "-m", "lfrender", "warm"]]
    assert "compiling kernels, once per installation" in capsys.readouterr().err


def test_true_shows_a_bar_on_a_terminal():
    pty = pytest.importorskip("pty", reason="there are no pseudo-terminals on this system")
    code = "import time\nfrom lfcal.runtime import progress\n"
    code += "from lfcal.runtime.compilation import compile_ahead\n"
    code += "compile_ahead.is_compiled = lambda: True\n"
    code += "with progress.show_progress(True, 'volume') as step:\n"
    code += "    step(7, 10)\n    time.sleep(0.5)\n"
    ours, theirs = pty.openpty()
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "120"}
    with subprocess.Popen([sys.executable, "-c", code], stderr=theirs, env=environment):
        os.close(theirs)
        shown = b""
        try:
            while piece := os.read(ours, 4096):
                shown += piece
        except OSError:  # the terminal is closed
            pass
    os.close(ours)
    for words in (b"volume", b"7/10", b"70%"):
        assert words in shown


@pytest.mark.parametrize("quiet", [False, True])
def test_commands_print_lines_at_times_where_nothing_is_a_terminal(monkeypatch, capsys, quiet):
    from lfcal.runtime.command_line import Report

    monkeypatch.setattr(progress, "_LINE_EVERY", 0.0)
    report = Report(quiet=quiet)
    with report.progress("volume 1") as step:
        step(3, 40)
    assert capsys.readouterr().err == ("" if quiet else "volume 1: 3 of 40 after 0 s\n")
