"""Sample data: the same pixels everywhere, traced once; captures of a lab by their hashes."""

from __future__ import annotations

import functools
import http.server
import threading

import numpy as np
import pytest

import lfcal
import lfrender

SMALL = {"size": (120, 90), "samples": 1}


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("LFRENDER_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.mark.parametrize("name", ["house", "clutter", "plane", "slope", "ramp", "periodic"])
def test_samples_are_traced_once_and_the_same_after_that(name, monkeypatch):
    first = getattr(lfrender.data, name)(**SMALL)
    monkeypatch.setattr("data_synth.simulate", None)
    again = getattr(lfrender.data, name)(**SMALL)
    np.testing.assert_array_equal(first.flat, again.flat)
    np.testing.assert_array_equal(first.truth.patch_size, again.truth.patch_size)
    assert first.flat.shape == (90, 120, 3)


def test_other_arguments_are_another_sample_and_damaged_ones_are_made_again(cache):
    one = lfrender.data.house(**SMALL)
    other = lfrender.data.house(**SMALL, seed=1)
    assert (one.flat != other.flat).any()
    folders = sorted((cache / "samples").iterdir())
    assert len(folders) == 2
    for folder in folders:
        (folder / "truth.json").write_text("{")
    np.testing.assert_array_equal(lfrender.data.house(**SMALL).flat, one.flat)


def test_board_comes_with_its_poses():
    first, again = (lfrender.data.board(size=(300, 240), poses=2, samples=1) for _ in range(2))
    assert len(first.flats) == 2 and first.rotations.shape == (2, 3, 3)
    np.testing.assert_array_equal(first.flats[1], again.flats[1])
    np.testing.assert_allclose(first.translations, again.translations)


def test_unwritable_cache_is_named(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("x")
    monkeypatch.setenv("LFRENDER_CACHE", str(tmp_path / "file"))
    with pytest.raises(lfcal.OutputError, match="LFRENDER_CACHE"):
        lfrender.data.house(**SMALL)


@pytest.fixture
def lab(tmp_path):
    """A folder with two captures and their list."""
    folder = tmp_path / "lab"
    (folder / "day one").mkdir(parents=True)
    for k, name in enumerate(("a.png", "day one/b.png")):
        lfrender.write_picture(folder / name, np.full((20, 30), k + 7, np.uint8))
    lfrender.data.write_registry(folder)
    return folder


def test_captures_are_read_from_a_folder_and_kept(lab):
    pytest.importorskip("pooch", reason="registries need lfrender[samples]")
    registry = lfrender.data.open_registry(lab)
    assert registry.names == ["a.png", "day one/b.png"]
    assert registry.read("day one/b.png")[0, 0] == 8
    (lab / "day one" / "b.png").unlink()
    assert registry.read("day one/b.png")[0, 0] == 8


def test_captures_are_read_from_a_server(lab):
    pytest.importorskip("pooch", reason="registries need lfrender[samples]")
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(lab))
    handler.log_message = lambda *_: None
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}"
        with pytest.raises(lfcal.FlatError, match="list of hashes"):
            lfrender.data.open_registry(address)
        registry = lfrender.data.open_registry(address, lab / "registry.txt")
        assert registry.read("a.png")[0, 0] == 7
        server.shutdown()


def test_other_bytes_than_those_listed_and_unknown_names_are_refused(lab):
    pytest.importorskip("pooch", reason="registries need lfrender[samples]")
    lfrender.write_picture(lab / "a.png", np.full((20, 30), 99, np.uint8))
    registry = lfrender.data.open_registry(lab)
    with pytest.raises(lfcal.FlatError, match=r"a\.png"):
        registry.read("a.png")
    with pytest.raises(lfcal.FlatError, match="not in the registry"):
        registry.read("c.png")
    (lab / "registry.txt").write_text("../../etc/passwd sha256:" + "0" * 64)
    with pytest.raises(lfcal.FlatError, match="line 1"):
        lfrender.data.open_registry(lab)
