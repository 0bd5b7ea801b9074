"""Tuned numbers are moved, and put back."""

from __future__ import annotations

import pytest

from benchmarks.sensitivity import moved, tuned_numbers
from lfrender.depth.settings import PIPELINE, PipelineSettings


def test_numbers_of_all_rooms_are_found():
    rooms = {kind.__module__.split(".")[2] for kind, _ in tuned_numbers()}
    assert {"matching", "refinement", "surface", "validity", "edges"} <= rooms
    assert (PipelineSettings, "unresolved_weight") in tuned_numbers()


def test_a_number_moves_in_the_defaults_and_comes_back():
    before = PIPELINE.unresolved_weight
    with pytest.raises(RuntimeError), moved(PipelineSettings, "unresolved_weight", 0.7):
        assert PIPELINE.unresolved_weight == pytest.approx(0.7 * before)
        raise RuntimeError
    assert before == PIPELINE.unresolved_weight


def test_whole_numbers_move_by_one_at_least():
    before = PIPELINE.sample
    with moved(PipelineSettings, "sample", 1.0 + 1e-9):
        assert before + 1 == PIPELINE.sample
