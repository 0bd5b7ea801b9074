"""Sequences and tiles on worker processes: the same bits as on one machine, also when a worker is
lost.
"""

from __future__ import annotations

import json
import os
import signal
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice

import cv2
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

import lfcal
import lfrender
from lfcal import OutputError
from lfrender.cli.main import main
from lfrender.sequence.workers import connect

pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def client():
    """Two worker processes; Dask restarts those that are killed."""
    with connect(2, None) as found:
        yield found


def kill_one(client):
    """Kill one of the workers."""
    os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)


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


def test_pictures_are_those_of_one_machine_although_a_worker_is_killed(
    frames, house, client, tmp_path
):
    camera = house.truth.calibration
    options = {"preset": "fast", "segment": 4, "group": 2}
    here = list(lfrender.render_frames(frames, tmp_path / "here", camera, **options))
    remote = {"client": client, "threads": 1, **options}
    running = lfrender.render_frames(frames, tmp_path / "there", camera, **remote)
    there = list(islice(running, 3))
    kill_one(client)
    there += list(running)
    assert [r.outcome for r in here] == ["rendered", "failed", *["rendered"] * 5]
    assert [(r.name, r.outcome, r.message) for r in here] == [
        (r.name, r.outcome, r.message) for r in there
    ]
    for result, other in zip(here, there, strict=True):
        if result.outcome == "rendered":
            assert result.path.read_bytes() == other.path.read_bytes()


@pytest.fixture
def flat(house, tmp_path):
    """A flat and its camera."""
    path = tmp_path / "flat.tif"
    tifffile.imwrite(path, house.flat, photometric="rgb")
    house.truth.calibration.save(tmp_path / "camera.json")
    return path, lfcal.load(tmp_path / "camera.json")


def killing(client, when):
    """A progress function that kills a worker at step `when`, and the numbers it got."""
    calls = []

    def progress(done, count):
        calls.append((done, count))
        if done == when:
            kill_one(client)

    return progress, calls


def test_tiles_are_those_of_one_machine_although_a_worker_is_killed(flat, client, tmp_path):
    path, camera = flat
    with lfcal.open_flat(path) as source:
        # 2 x 2 tiles.
        here = lfrender.analyze_large(source, camera, "fast", memory=1.0)
        progress, calls = killing(client, 2)
        options = {"memory": 1.0, "client": client, "threads": 1, "progress": progress}
        there = lfrender.analyze_large(source, camera, "fast", **options)
        assert calls == [(k + 1, 4) for k in range(4)]
        for name in ("patch_size", "standard_error", "confidence", "filled_patch_size", "reason"):
            np.testing.assert_array_equal(getattr(here, name), getattr(there, name))
        np.testing.assert_array_equal(here.surface.patch_size, there.surface.patch_size)
        lfrender.render_large(source, tmp_path / "here.tif", camera, here, tile=40)
        progress, calls = killing(client, 5)
        made = lfrender.render_large(
            source,
            tmp_path / "there.tif",
            camera,
            here,
            tile=40,
            client=client,
            threads=1,
            progress=progress,
        )
    assert len(calls) == made.tiles >= 12
    assert (tmp_path / "here.tif").read_bytes() == (tmp_path / "there.tif").read_bytes()


def test_commands_on_large_flats_take_workers_and_a_dark_frame(flat, client, tmp_path, monkeypatch):
    path, camera = flat
    black = np.random.default_rng(5).integers(0, 20, camera.image_size[::-1], np.uint8)
    dark = tmp_path / "dark.tif"
    tifffile.imwrite(dark, black)

    @contextmanager
    def connected(workers, scheduler):
        assert (workers, scheduler) == (2, None)
        yield client

    monkeypatch.setattr("lfrender.sequence.workers.connect", connected)
    given = ["-c", str(tmp_path / "camera.json"), "--workers", "2", "--preset", "fast", "--json"]
    given += ["--dark", str(dark)]
    analyzed = ["analyze", str(path), "-o", str(tmp_path / "depth.npz"), *given]
    rendered = ["render", str(path), "-o", str(tmp_path / "there.tif"), *given, "--tile", "80"]
    figures = [
        json.loads(CliRunner().invoke(main, c, catch_exceptions=False).stdout)
        for c in (analyzed, rendered)
    ]
    assert figures[1]["tiles"] == 4
    # Values from which a dark frame can be subtracted are linear.
    linear = replace(camera, encoded=False)
    with lfcal.open_flat(path, dark=dark) as source:
        depth = lfrender.analyze_large(source, linear, "fast")
    np.testing.assert_array_equal(
        lfrender.DepthMap.load(tmp_path / "depth.npz").patch_size, depth.patch_size
    )
    whole = lfrender.render(lfcal.subtract_dark(lfcal.read_flat(path), black), linear, depth)
    np.testing.assert_array_equal(lfcal.read_flat(tmp_path / "there.tif"), whole.image)
    refused = CliRunner().invoke(main, [*rendered, "--roi", "0", "0", "9", "9"])
    assert refused.exit_code == 2 and "--roi" in refused.stderr


def test_flats_that_workers_cannot_read_are_reported(flat, client):
    path, camera = flat
    with lfcal.open_flat(path) as source:
        path.write_bytes(path.read_bytes()[:-1000])
        with pytest.raises(lfcal.FlatError, match=r"flat\.tif: truncated TIFF"):
            lfrender.analyze_large(source, camera, "fast", client=client)


def test_unreachable_scheduler_is_one_line():
    with (
        pytest.raises(OutputError, match="no Dask scheduler"),
        connect(None, "tcp://127.0.0.1:9", timeout=0.2),
    ):
        pass
