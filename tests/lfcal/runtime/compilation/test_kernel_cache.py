"""Damaged files of compiled kernels are noticed before Numba loads them."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

_MODULE = """
import sys
import numpy as np
from lfcal.runtime.kernels import kernel

@kernel
def twice(values):
    return 2 * values.sum()

print(twice(np.ones(3, sys.argv[1])), sum(twice.stats.cache_misses.values()))
"""
_NOTE = "note: damaged files of compiled kernels were removed; these kernels are compiled again\n"


@pytest.fixture
def run(tmp_path):
    """Runs a script with one kernel; gives its result, how often it was compiled, and stderr."""
    script = tmp_path / "script.py"
    script.write_text(_MODULE)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def run(kind="f8"):
        command = [sys.executable, str(script), kind]
        done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
        result, compiled = done.stdout.split()
        return float(result), int(compiled), done.stderr

    return run


_DAMAGES = {
    "empty": lambda data: b"",
    "cut": lambda data: data[: len(data) // 2],
    "zeros": lambda data: bytes(len(data)),
    "flipped": lambda data: data[: len(data) // 2] + bytes(9) + data[len(data) // 2 + 9 :],
    "one bit": lambda data: data[:-500] + bytes([data[-500] ^ 1]) + data[-499:],
}


@pytest.mark.parametrize("damage", _DAMAGES.values(), ids=_DAMAGES)
@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
def test_a_damaged_kernel_is_removed_compiled_again_and_a_note_says_so(
    run, tmp_path, suffix, damage
):
    assert run() == (6.0, 1, "")
    assert run() == (6.0, 0, "")
    (file,) = (tmp_path / "cache").rglob(f"*.{suffix}")
    file.write_bytes(damage(file.read_bytes()))
    assert run() == (6.0, 1, _NOTE)
    assert run() == (6.0, 0, "")


def test_further_types_and_a_new_source_are_no_damages(run, tmp_path):
    assert run() == (6.0, 1, "")
    (record,) = (tmp_path / "cache").rglob("*.crc.json")
    before = record.read_bytes()
    assert run("f4") == (6.0, 1, "")
    # As after a process that was killed before it wrote the checksums.
    record.write_bytes(before)
    assert run() == (6.0, 0, "")
    assert run("f4") == (6.0, 0, "")
    script = tmp_path / "script.py"
    script.write_text(_MODULE.replace("2 * values", "3 * values"))
    assert run() == (9.0, 1, "")
    assert run() == (9.0, 0, "")


def test_a_record_that_cannot_be_read_is_no_error(run, tmp_path):
    run()
    (record,) = (tmp_path / "cache").rglob("*.crc.json")
    record.write_text("{")
    assert run() == (6.0, 0, "")
