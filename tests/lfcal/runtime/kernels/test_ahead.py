"""Kernels are compiled ahead in other processes, which leave them in the cache."""

from __future__ import annotations

import json

import pytest

from lfcal.runtime.kernels import ahead
from lfcal.runtime.kernels.ahead import compile_ahead, compile_once, is_compiled
from lfcal.runtime.kernels.signatures import Signature

MASK, ROWS, OUT = (["array", kind, axes, "C", True] for kind, axes in (("bool", 1), ("int32", 2), ("int8", 1)))
FIRST = Signature("lfrender.flat.lens_graph", "_count_in_mask", json.dumps(["int64", "int64", MASK, ROWS, OUT]))
ABSENT = FIRST._replace(name="absent")


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """The folder of the cache, empty."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_kernels_are_left_in_the_cache_and_those_that_do_not_fit_are_counted(cache):
    seen = []
    assert compile_ahead([FIRST, ABSENT], progress=lambda done, count: seen.append((done, count))) == 1
    assert seen == [(1, 2), (2, 2)]
    assert len(list(cache.rglob("lens_graph._count_in_mask*.nbc"))) == 1


def test_kernels_are_those_of_the_packages_of_this_process_not_of_the_folder_it_works_in(tmp_path, monkeypatch):
    (tmp_path / "lfcal").mkdir()
    (tmp_path / "lfcal" / "__init__.py").write_text("raise ImportError('another one')")
    monkeypatch.chdir(tmp_path)
    assert compile_ahead([FIRST]) == 0


def test_all_types_of_a_kernel_are_compiled_by_one_process(cache):
    other = FIRST._replace(types=FIRST.types.replace("int8", "int64"))
    assert compile_ahead([FIRST, ABSENT, other], processes=2) == 1
    assert len(list(cache.rglob("lens_graph._count_in_mask*.nbc"))) == 2


def test_an_installation_compiles_its_kernels_once(cache, monkeypatch):
    monkeypatch.setattr(ahead, "read_signatures", lambda: (FIRST, ABSENT))
    assert not is_compiled()
    assert compile_once() == 1
    assert is_compiled()
    monkeypatch.setattr(ahead, "read_signatures", lambda: pytest.fail("compiled again"))
    assert compile_once() == 0
    # Another Numba or another version of the package has other kernels.
    monkeypatch.setattr(ahead, "version", lambda _: "0.0")
    assert not is_compiled()


def test_a_folder_that_cannot_be_made_is_no_error(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file" / "cache"))
    monkeypatch.setattr(ahead, "read_signatures", tuple)
    assert compile_once() == 0
    assert not is_compiled()
