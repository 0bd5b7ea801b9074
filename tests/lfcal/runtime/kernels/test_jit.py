"""Kernels are compiled by what Numba promises to keep."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[4]
PRIVATE = ("numba.core", "llvmlite", "getrefcount", "_nrt", "gc.freeze", "GOMP_SPINCOUNT")


@pytest.mark.parametrize("package", ["lfcal", "lfrender", "data_synth"])
def test_no_private_parts_of_numba_and_python_are_used(package):
    sources = {path: path.read_text(encoding="utf-8") for path in (ROOT / package).rglob("*.py")}
    assert sources
    assert [(path.name, part) for path, text in sources.items() for part in PRIVATE if part in text] == []
