"""Kernels from the cache can be called, and linked with others."""

from __future__ import annotations

import subprocess
import sys

CODE = """
import sys
from lfcal.runtime.kernels.jit import njit

@njit(cache=True, nogil=True)
def twice(value):
    return 2 * value

@njit(cache=True, nogil=True)
def plus_one(value):
    return twice(value) + 1

assert twice(21) == 42
if sys.argv[1] == "link":
    assert plus_one(21) == 43
hits = sum(twice.stats.cache_hits.values())
parsed = [overload.library._bitcode is None for overload in twice.overloads.values()]
print(hits, parsed)
"""


def test_cached_code_is_parsed_for_linking_only(tmp_path):
    path = tmp_path / "kernels.py"
    path.write_text(CODE, encoding="utf-8")

    def run(what):
        done = subprocess.run([sys.executable, path, what], capture_output=True, text=True, check=True)
        return done.stdout.strip()

    assert run("call") == "0 [True]"
    assert run("call") == "1 [False]"
    assert run("link") == "1 [True]"
