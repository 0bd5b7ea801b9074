"""Damaged, hostile and half-written files: refused in words, in bounded time, and never left
behind.
"""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import lfcal
from benchmarks.stress.file_faults import fuzz

_ROOT = Path(__file__).parents[2]


def test_damaged_files_of_every_kind_end_in_an_error_of_the_family_that_names_the_file(tmp_path):
    tried, faults = fuzz(tmp_path, range(25))
    assert tried >= 300
    assert not faults


def test_archives_with_damaged_entries_are_no_depth_files(tmp_path):
    import numpy as np

    import lfrender

    whole = tmp_path / "whole.npz"
    np.savez(whole, version=np.int64(2))
    data = bytearray(whole.read_bytes())
    # Compression method and flags of the entry, in both of its headers: no method has number 77,
    # bit 5 is patched data.
    for offset, start in ((8, data.find(b"PK\3\4")), (10, data.find(b"PK\1\2"))):
        for flags, method in ((0, 77), (32, 0)):
            bad = data.copy()
            bad[start + offset - 2 : start + offset + 2] = bytes([flags, 0, method, 0])
            (tmp_path / "bad.npz").write_bytes(bad)
            with pytest.raises(lfcal.LightFieldError, match="depth file"):
                lfrender.DepthMap.load(tmp_path / "bad.npz")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"basis": [[0.002, 0], [0, 0.002]]}, "no camera has"),
        ({"basis": [[20, 0], [1e9, 20]]}, "no camera has"),
        ({"origin": [1e300, 0]}, "field lattice"),
    ],
)
def test_lattices_with_more_lenses_than_memory_holds_are_refused(tmp_path, change, message):
    path = tmp_path / "camera.json"
    lfcal.Calibration(lfcal.Lattice((10, 10), ((9, 0), (0, 9)), (300, 200), 4)).save(path)
    data = json.loads(path.read_text())
    data["lattice"] |= change
    path.write_text(json.dumps(data))
    with pytest.raises(lfcal.CameraFileError, match=message):
        lfcal.load(path)
    data["lattice"] |= {"basis": [[9, 0], [0, 9]], "origin": [10, 10]}
    data["image_size"] = [10**9, 10**9]
    path.write_text(json.dumps(data))
    with pytest.raises(lfcal.CameraFileError, match="no camera has"):
        lfcal.load(path)


def test_killed_writers_and_full_disks_leave_outputs_absent_or_whole(tmp_path):
    command = [sys.executable, "-m", "benchmarks.stress.write_faults", str(tmp_path / "kill"), "8"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=_ROOT, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_folder_nobody_can_write_to_is_named():
    path = Path("/proc/self/camera.json")
    if not path.parent.exists():
        pytest.skip("no such folder on this system")
    camera = lfcal.Calibration(lfcal.Lattice((10, 10), ((9, 0), (0, 9)), (300, 200), 4))
    with pytest.raises(lfcal.OutputError, match=r"camera\.json"):
        camera.save(path)


def test_nothing_is_ever_unpickled():
    for package in ("lfcal", "lfrender", "data_synth"):
        for source in (_ROOT / package).glob("*.py"):
            text = source.read_text(encoding="utf-8")
            assert "import pickle" not in text and "allow_pickle=True" not in text, source
