from dataclasses import replace

import numpy as np

from benchmarks.random_scenes import draw, judge


def test_a_plane_is_judged_right_and_a_false_truth_wrong():
    described, capture = draw(8, samples=32)
    assert described.startswith("plane")
    found = judge(capture)
    assert found.right > 0.995
    assert found.median < 0.02
    assert found.wanted
    truth = capture.truth
    false = judge(replace(capture, truth=replace(truth, mode=-truth.mode, patch_size=truth.patch_size + 1)))
    assert false.wrong > 0.995
    assert np.isclose(false.median, 1, atol=0.02)
    assert false.within < 0.01
    assert not false.wanted
