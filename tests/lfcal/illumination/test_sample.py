"""Samples of lenses by windows of the field."""

from __future__ import annotations

import pytest

from lfcal.illumination.sample import draw_sample
from lfcal.lattice.lattice import Lattice


def test_thinned_sample_keeps_lenses_in_their_windows():
    sample = draw_sample(Lattice([3.0, 2.0], [[12.1, 0.2], [5.9, 10.4]], (900, 700), 5.0), 1e6)
    some = sample.thin(3)
    assert some.shape == sample.shape and len(some.centres) == some.first[-1]
    assert len(some.centres) == pytest.approx(len(sample.centres) / 3, abs=1)
    for number in range(len(sample.first) - 1):
        own, fewer = (of.centres[of.first[number] : of.first[number + 1]].tolist() for of in (sample, some))
        assert len(fewer) == pytest.approx(len(own) / 3, abs=1) and all(centre in own for centre in fewer)
