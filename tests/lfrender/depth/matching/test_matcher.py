import numpy as np

from lfrender.depth.matching.matcher import MatchResult


def found(confidence):
    values = [np.float32([k, k + 0.5]) for k in range(10)]
    values[1] = np.float32(confidence)
    return MatchResult(*values, step=1.0, skipped_share=0.0)


def test_swapped_lenses_take_the_second_value_and_lose_confidence():
    before = found([0.9, 0.4])
    turned = before.swap_second(np.array([True, False]))
    for one, other in (
        ("patch_size", "second"),
        ("correlation", "second_correlation"),
        ("normalised_correlation", "second_normalised"),
    ):
        a, b = getattr(before, one), getattr(before, other)
        assert getattr(turned, one).tolist() == [b[0], a[1]]
    assert turned.second.tolist() == [before.patch_size[0], before.second[1]]
    assert 0.5 <= turned.confidence[0] < 0.9
    assert turned.confidence[1] == before.confidence[1]
    assert found([0.3, 1]).swap_second(np.ones(2, bool)).confidence[0] == np.float32(0.3)
    assert turned.uniqueness is before.uniqueness
