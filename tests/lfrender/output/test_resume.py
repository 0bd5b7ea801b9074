"""Intermediate results of long runs: used again for the same inputs, computed again for others."""

from __future__ import annotations

import os

import numpy as np
import pytest

from lfcal import OutputError
from lfrender.output.resume import Checkpoint, fingerprint


def test_a_removed_checkpoint_leaves_nothing_behind(tmp_path):
    output = tmp_path / "out.tif"
    checkpoint = Checkpoint(output, "picture", "inputs")
    checkpoint.keep({"0": 5})
    assert Checkpoint(output, "picture", "inputs").found == {"0": 5}
    assert Checkpoint(output, "picture", "other inputs").found is None
    assert Checkpoint(output, "depth", "inputs").found is None
    checkpoint.remove()
    assert os.listdir(tmp_path) == []
    assert Checkpoint(output, "picture", "inputs").found is None


def test_stages_of_one_output_are_kept_side_by_side(tmp_path):
    Checkpoint(tmp_path / "out.tif", "depth", 1).keep()
    Checkpoint(tmp_path / "out.tif", "picture", 2).keep([3])
    assert Checkpoint(tmp_path / "out.tif", "depth", 1).found is True
    assert Checkpoint(tmp_path / "out.tif", "picture", 2).found == [3]


@pytest.mark.parametrize("damaged", ["{damaged", "[1]", "null"])
def test_a_damaged_state_is_ignored_and_a_missing_folder_reported(tmp_path, damaged):
    checkpoint = Checkpoint(tmp_path / "out.tif", "picture")
    checkpoint.keep()
    (checkpoint.folder / "state.json").write_text(damaged)
    assert Checkpoint(tmp_path / "out.tif", "picture").found is None
    with pytest.raises(OutputError, match="cannot be written"):
        Checkpoint(tmp_path / "missing" / "out.tif", "picture").open()


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
    before = fingerprint(path, None)
    path.write_bytes(b"12")
    assert fingerprint(path, None) != before
