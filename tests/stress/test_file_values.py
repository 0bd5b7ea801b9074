"""Depth and camera files with wrong values are refused in one line, or give the same picture."""

from __future__ import annotations

from benchmarks.stress.file_values import fuzz_cameras, fuzz_depths


def test_depth_files_with_wrong_values_are_refused_in_one_line_or_give_the_same_picture(tmp_path):
    tried, refused, faults = fuzz_depths(tmp_path, 25)
    assert tried >= 20
    assert refused >= tried // 2
    assert not faults


def test_camera_files_with_wrong_values_are_refused_in_one_line_or_noticed(tmp_path):
    tried, refused, faults = fuzz_cameras(tmp_path, 30)
    assert tried >= 25
    assert refused >= tried // 2
    assert not faults
