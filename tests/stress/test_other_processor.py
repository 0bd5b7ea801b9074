"""The comparison with another processor can fail."""

import numpy as np
import pytest

from benchmarks.stress.other_processor import LIMIT, differences


def test_differences_are_measured_against_the_largest_value_of_their_kind():
    ours = {"centres": np.array([[100.0, 200.0], [300.0, 400.0]]), "picture": np.ones(3)}
    near = {"centres": ours["centres"] + 2e-3, "picture": np.ones(3)}
    found = differences(ours, near)
    assert found["centres"] == pytest.approx(5e-6)
    assert found["picture"] == 0
    assert (
        differences(ours, near | {"picture": np.array([1.0, 1 + 2 * LIMIT, 1])})["picture"] > LIMIT
    )
    assert differences(ours, near | {"picture": np.ones(4)})["picture"] == np.inf
    assert not differences(ours, near | {"picture": np.array([1.0, np.nan, 1])})["picture"] <= LIMIT
