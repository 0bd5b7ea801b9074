"""Intermediate results of long runs: used again for the same inputs, computed again for others."""

from __future__ import annotations

import os

import numpy as np
import pytest

from lfcal import OutputError
from lfrender.output.resume import Checkpoint, file_identity, fingerprint


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
    different = [
        fingerprint(one),
        fingerprint(one.reshape(2, 3)),
        fingerprint(one.astype(np.int64)),
        fingerprint([1]),
    ]
    assert len(set(different)) == 4
    path = tmp_path / "a.png"
    path.write_bytes(b"1")
    before = file_identity(path)
    path.write_bytes(b"12")
    assert file_identity(path) != before
    assert file_identity(None) == []
