"""Kernels are compiled ahead in other processes, which leave them in the cache, once per
installation.
"""

from __future__ import annotations

import json

import pytest

from benchmarks.kernels import encode_type
from lfcal.runtime.compilation import compile_ahead as ahead

KERNEL = [
    "lfcal.images.preprocessing._edge_strength",
    "int64",
    "int64",
    ["array", "float32", 2, "C", True],
    ["array", "float32", 2, "C", True],
]
ABSENT = ["lfcal.images.preprocessing.absent", "int64"]


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """The folder of the cache, empty, and a list of two kernels, one of which does not exist."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    listed = tmp_path / "signatures.json"
    listed.write_text(
        json.dumps([KERNEL, ABSENT, [*KERNEL[:-1], ["array", "float64", 2, "C", True]]])
    )
    monkeypatch.setattr(ahead, "SIGNATURE_FILE", listed)
    return tmp_path / "cache"


def test_an_installation_compiles_its_kernels_once_and_counts_those_that_do_not_fit(
    tmp_path, cache, monkeypatch
):
    # Of the packages of this process, not of the folder it works in.
    (tmp_path / "lfcal").mkdir()
    (tmp_path / "lfcal" / "__init__.py").write_text("raise ImportError('another one')")
    monkeypatch.chdir(tmp_path)
    seen = []
    assert not ahead.is_compiled()
    assert ahead.compile_once(2, lambda done, count: seen.append((done, count))) == 1
    assert seen == [(1, 2), (2, 2)]
    assert len(list(cache.rglob("preprocessing._edge_strength*.nbc"))) == 2
    assert ahead.is_compiled()
    monkeypatch.setattr(ahead, "compile_ahead", lambda *_: pytest.fail("compiled again"))
    assert ahead.compile_once() == 0
    # Another Numba or another version of the package has other kernels.
    monkeypatch.setattr(ahead, "version", lambda _: "0.0")
    assert not ahead.is_compiled()


def test_a_folder_that_cannot_be_made_is_no_error(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file" / "cache"))
    monkeypatch.setattr(ahead, "compile_ahead", lambda *_: 0)
    assert ahead.compile_once() == 0
    assert not ahead.is_compiled()


def test_listed_kernels_exist_and_their_types_can_be_read(monkeypatch):
    monkeypatch.undo()
    for name, *entries in json.loads(ahead.SIGNATURE_FILE.read_text()):
        # Record the list again, with `python -m benchmarks.kernels --record`.
        assert callable(
            ahead.import_module(name.rpartition(".")[0]).__dict__.get(name.rpartition(".")[2])
        ), name
        assert [encode_type(ahead.decode_type(entry)) for entry in entries] == entries
