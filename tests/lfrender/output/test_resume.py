"""Intermediate results of long runs: used again for the same inputs, computed again for others."""

from __future__ import annotations

import os

import numpy as np
import pytest

from lfcal import OutputError
from lfrender.output.resume import Checkpoint, file_identity, fingerprint


class Number:
    """A result that can be saved."""

    def __init__(self, value):
        self.value = value

    def save(self, path):
        path.write_text(str(self.value))

    @classmethod
    def load(cls, path):
        return cls(int(path.read_text()))


def test_results_are_computed_once_for_each_key_and_by_any_later_run(tmp_path):
    calls = []

    def reuse(key):
        return Checkpoint(tmp_path / "out.tif").reuse("n.txt", key, Number.load, lambda: calls.append(1) or Number(7))

    assert [reuse("a").value, reuse("a").value, len(calls)] == [7, 7, 1]
    reuse("b")
    assert len(calls) == 2
    (tmp_path / ".out.tif.unfinished" / "n.txt").unlink()
    reuse("b")
    assert len(calls) == 3


def test_a_removed_checkpoint_leaves_nothing_behind(tmp_path):
    checkpoint = Checkpoint(tmp_path / "out.tif")
    checkpoint.keep("picture", "key", {"0": 5})
    assert Checkpoint(tmp_path / "out.tif").find("picture", "key") == {"0": 5}
    assert Checkpoint(tmp_path / "out.tif").find("picture", "other key") is None
    checkpoint.remove()
    assert os.listdir(tmp_path) == []
    assert Checkpoint(tmp_path / "out.tif").find("picture", "key") is None


def test_a_damaged_state_is_ignored_and_a_missing_folder_reported(tmp_path):
    checkpoint = Checkpoint(tmp_path / "out.tif")
    checkpoint.keep("picture", "key")
    (checkpoint.folder / "state.json").write_text("{damaged")
    assert Checkpoint(tmp_path / "out.tif").find("picture", "key") is None
    with pytest.raises(OutputError, match="cannot be written"):
        Checkpoint(tmp_path / "missing" / "out.tif").open()


def test_fingerprints_differ_by_values_types_and_files(tmp_path):
    one = np.arange(6, dtype=np.int32)
    different = [fingerprint(one), fingerprint(one.reshape(2, 3)), fingerprint(one.astype(np.int64)), fingerprint([1])]
    assert len(set(different)) == 4
    path = tmp_path / "a.png"
    path.write_bytes(b"1")
    before = file_identity(path)
    path.write_bytes(b"12")
    assert file_identity(path) != before
    assert file_identity(None) == []
