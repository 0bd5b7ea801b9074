"""TIFF files with changed tags are refused in one line, but for those that tags cannot tell."""

from __future__ import annotations

from benchmarks.stress.tiff_tags import fuzz_tags


def test_tiff_files_with_changed_tags_are_refused_in_one_line():
    refused, others, faults = fuzz_tags(200, seed=7)
    assert refused >= 180
    assert len(others) <= 4
    assert not faults
