"""Compiled kernels are found again by other processes, and only while they are what they were."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

HELPER = """
from lfcal.runtime.kernels.jit import njit

@njit(cache=True)
def scaled(value):
    return value * 3
"""
KERNEL = """
from lfcal.runtime.kernels.jit import njit
from lfcal.digested.helper import scaled

@njit(cache=True)
def run(value):
    return scaled(value) + 1
"""
CALL = """
import sys
import lfcal
lfcal.__path__.append(sys.argv[1])
from lfcal.digested.kernel import run
print(run(2), sum(run.stats.cache_hits.values()))
"""


@pytest.fixture
def call(tmp_path):
    """Runs the kernel in a new process: its result, and how often it came from the cache."""
    folder = tmp_path / "digested"
    folder.mkdir()
    (folder / "kernel.py").write_text(KERNEL)

    def run(helper=HELPER):
        (folder / "helper.py").write_text(helper)
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
        command = [sys.executable, "-c", CALL, str(tmp_path)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        return tuple(map(int, done.stdout.split()))

    run.cache = tmp_path / "cache"
    return run


def test_a_kernel_is_made_anew_when_a_function_of_another_file_changes(call):
    assert call() == (7, 0)
    assert call() == (7, 1)
    assert call(HELPER.replace("3", "5")) == (11, 0)
    # No locks are left.
    assert not list(call.cache.rglob("*.lock"))


def test_a_damaged_entry_is_made_anew(call):
    call()
    for file in call.cache.rglob("kernel.run*"):
        file.write_bytes(file.read_bytes()[:20])
    assert call() == (7, 0)
    assert call() == (7, 1)


def test_types_that_do_not_fit_keep_no_other_from_being_compiled(call, tmp_path):
    call()
    compile_two = """
import json, sys, lfcal
from numba import errors, types
from lfcal.runtime.kernels.signatures import Signature, encode_type
lfcal.__path__.append(sys.argv[1])
for kind in (types.none, types.float32):
    try:
        Signature("lfcal.digested.kernel", "run", json.dumps([encode_type(kind)])).compile()
        print("compiled")
    except errors.TypingError:
        print("failed")
"""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(call.cache), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run([sys.executable, "-c", compile_two, str(tmp_path)], env=environment, capture_output=True,
                          text=True, check=True, timeout=60)  # fmt: skip
    assert done.stdout.split() == ["failed", "compiled"]
    assert not list(call.cache.rglob("*.lock"))


def test_a_kernel_is_made_anew_when_fields_of_its_named_tuple_change_places(call):
    helper = (
        HELPER.partition("@njit")[0]
        + """
from typing import Any, NamedTuple

class Pair(NamedTuple):
    first: Any
    second: Any

@njit(cache=True)
def take(pair):
    return pair.first

@njit(cache=True)
def scaled(value):
    return take(Pair(first=value, second=-value))
"""
    )
    assert call(helper)[0] == 3
    swapped = helper.replace("    first: Any\n    second: Any", "    second: Any\n    first: Any")
    assert call(swapped)[0] == 3
