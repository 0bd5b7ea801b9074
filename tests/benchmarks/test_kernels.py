"""Compiled kernels are deleted when any part of them has changed, and only then."""

from __future__ import annotations

import os

import pytest

from benchmarks import kernels
from benchmarks.kernels import discard_outdated

SOURCES = {
    "lfcal/inner.py": "",
    "lfcal/room/kernel.py": "from ..inner import part",
    "lfcal/room/other.py": "",
}


@pytest.fixture
def indices(tmp_path, monkeypatch):
    """Indices of two modules with kernels, the first of which imports another module."""
    monkeypatch.setattr(kernels, "_ROOT", tmp_path)
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    for name, text in SOURCES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
        os.utime(tmp_path / name, (1000, 1000))
    folder = tmp_path / "lfcal" / "room" / "__pycache__"
    folder.mkdir()
    found = [folder / "kernel.run-12.py311.nbi", folder / "other.run-3.py311.nbi"]
    for file in found:
        file.touch()
        os.utime(file, (2000, 2000))
    return found


def test_nothing_is_deleted_while_sources_are_older(indices):
    assert discard_outdated() == 0


def test_a_changed_function_of_another_file_outdates_the_kernels_that_import_it(indices, tmp_path):
    os.utime(tmp_path / "lfcal" / "inner.py", (3000, 3000))
    assert discard_outdated() == 1
    assert [file.exists() for file in indices] == [False, True]
