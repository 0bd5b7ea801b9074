"""Kernels from the cache can be called, and linked with others."""

from __future__ import annotations

import subprocess
import sys

import pytest

CODE = """
import sys
from lfcal.runtime.kernels.jit import njit

@njit(cache=True, nogil=True)
def twice(value):
    value = max(value, -100)
    if value < 0:
        raise ValueError("below", value)
    return 2 * value

@njit(cache=True, nogil=True)
def plus_one(value):
    return twice(value) + 1

if sys.argv[1] != "only link":
    assert twice(21) == 42
if sys.argv[1] != "call":
    assert plus_one(21) == 43
hits = sum(twice.stats.cache_hits.values())
parsed = [overload.library._bitcode is None for overload in twice.overloads.values()]
if sys.argv[1] == "fail":
    try:
        plus_one(-1)
    except ValueError as error:
        parsed = error.args
if hits and sys.argv[1] == "call":
    assert "numba.np.linalg" not in sys.modules
print(hits, parsed, [overload.library._waits for overload in twice.linked.overloads.values()])
"""


def _run(path, what):
    done = subprocess.run([sys.executable, path, what], capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.fixture
def path(tmp_path):
    """A file with two kernels, of which one calls the other."""
    path = tmp_path / "kernels.py"
    path.write_text(CODE, encoding="utf-8")
    return path


def test_cached_code_is_not_parsed_to_be_called(path):
    assert _run(path, "call") == "0 [True] []"
    assert _run(path, "call") == "1 [False] []"


def test_a_kernel_that_only_kernels_call_gets_no_machine_code(path):
    assert _run(path, "only link") == "0 [] [True]"
    # The machine code of the other holds it.
    assert _run(path, "only link") == "0 [] []"
    assert _run(path, "link") == "0 [True] []"


def test_errors_of_a_kernel_within_another_are_those_of_python(path):
    for made in ("[True]", "[]"):
        assert _run(path, "fail").endswith(f"('below', -1) {made}")
