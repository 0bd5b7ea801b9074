"""Kernels are compiled ahead in other processes, which leave them in the cache."""

from __future__ import annotations

import json

from lfcal.runtime.kernels import ahead
from lfcal.runtime.kernels.ahead import compile_ahead, remaining_stages, signatures_of
from lfcal.runtime.kernels.signatures import Signature, read_signatures

TYPES = json.dumps([["array", "float64", 1, "C", True], "float64"])
FIRST = Signature("lfrender.runtime.order_statistics", "count_below", TYPES)


def test_kernels_are_left_in_the_cache_and_those_that_do_not_fit_are_counted(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    seen = []
    absent = FIRST._replace(name="absent")
    assert compile_ahead([FIRST, absent], progress=lambda done, count: seen.append((done, count))) == 1
    assert seen == [(1, 2), (2, 2)]
    assert len(list(tmp_path.rglob("order_statistics.count_below*.nbc"))) == 1


def test_kernels_are_those_of_the_packages_of_this_process_not_of_the_folder_it_works_in(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "lfcal").mkdir()
    (tmp_path / "lfcal" / "__init__.py").write_text("raise ImportError('another one')")
    monkeypatch.chdir(tmp_path)
    assert compile_ahead([FIRST]) == 0


def test_the_dearest_kernels_of_all_stages_come_first(monkeypatch):
    dear, cheap = FIRST._replace(name="dear"), FIRST._replace(name="cheap")
    stages = {"calibrate": (dear, cheap), "render": (FIRST, cheap)}
    monkeypatch.setattr(ahead, "read_signatures", lambda: stages)
    assert signatures_of(stages) == [dear, FIRST, cheap]


def test_stages_that_follow_are_those_of_the_same_kind_of_flat_and_program(monkeypatch):
    other = FIRST._replace(module="data_synth.tracing")
    names = "simulate", "calibrate", "render", "calibrate, gray", "render, gray"
    stages = {name: (FIRST._replace(name=name),) for name in names} | {"show": (other,)}
    monkeypatch.setattr(ahead, "read_signatures", lambda: stages)
    assert remaining_stages(FIRST._replace(name="calibrate"), {"lfrender"}) == ["calibrate", "render"]
    assert remaining_stages(FIRST._replace(name="calibrate, gray"), {"lfrender"}) == ["calibrate, gray", "render, gray"]
    assert remaining_stages(FIRST, {"lfrender"}) == []


def test_the_list_holds_the_stages_of_the_demo():
    assert {"simulate", "calibrate", "analyze", "render"} <= set(read_signatures())
