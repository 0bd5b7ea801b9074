"""A sequence on worker processes: the same pictures as on one machine, also when a worker is lost."""

from __future__ import annotations

import os
import signal
from itertools import islice

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import lfrender
from lfcal import OutputError
from lfrender.cli import main
from lfrender.cluster import connect

pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def frames(house, tmp_path_factory):
    """Seven frames, the second of them damaged, with something else in a part of the last three."""
    folder = tmp_path_factory.mktemp("frames")
    for k in range(7):
        flat = house.flat.copy()
        if k > 3:
            flat[:120, :150] = flat[200:320, 200:350]
        cv2.imwrite(str(folder / f"f{k}.png"), flat[..., ::-1])
    damaged = folder / "f1.png"
    damaged.write_bytes(damaged.read_bytes()[:3000])
    return lfrender.open_frames([folder])


def test_pictures_are_those_of_one_machine_although_a_worker_is_killed(frames, house, tmp_path, monkeypatch):
    for module in ("batch", "cluster"):
        monkeypatch.setattr(f"lfrender.{module}.STRETCH", 3)
    camera = house.truth.calibration
    here = list(lfrender.render_frames(frames, tmp_path / "here", camera, preset="fast"))
    with connect(2, None) as client:
        pids = list(client.run(os.getpid).values())
        running = lfrender.render_frames_on(client, frames, tmp_path / "there", camera, preset="fast", threads=1)
        there = list(islice(running, 3))
        os.kill(pids[0], signal.SIGKILL)
        there += list(running)
    assert [r.outcome for r in here] == ["rendered", "failed", *["rendered"] * 5]
    assert [(r.name, r.outcome, r.message) for r in here] == [(r.name, r.outcome, r.message) for r in there]
    for result, other in zip(here, there, strict=True):
        if result.outcome == "rendered":
            assert result.path.read_bytes() == other.path.read_bytes()


def test_scheduler_that_does_not_answer_is_one_line(frames, tmp_path, monkeypatch):
    monkeypatch.setattr("lfrender.cluster._PATIENCE", 0.2)
    with pytest.raises(OutputError, match="no Dask scheduler"), connect(None, "tcp://127.0.0.1:9"):
        pass
    flat = tmp_path / "f.png"
    cv2.imwrite(str(flat), np.zeros((50, 60), np.uint8))
    arguments = ["batch", str(flat), "-o", str(tmp_path / "out"), "--scheduler", "tcp://127.0.0.1:9"]
    assert CliRunner().invoke(main, arguments).exit_code == 2
