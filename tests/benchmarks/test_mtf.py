"""MTF50 of a slanted edge."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erf

from benchmarks.mtf import mtf50, star_contrast


@pytest.mark.parametrize("sigma", [0.7, 1.0, 1.6])
def test_a_normal_blur_has_the_mtf50_of_its_formula(sigma):
    rows, columns = np.mgrid[:48, :61]
    distance = (columns - 30.2) * np.cos(0.09) + (rows - 24) * np.sin(0.09)
    edge = 0.2 + 0.3 * (1 + erf(distance / sigma / 2**0.5))
    assert mtf50(edge) == pytest.approx(np.sqrt(np.log(2) / 2) / (np.pi * sigma), rel=0.05)


def test_a_star_has_the_contrast_it_was_drawn_with():
    rows, columns = np.mgrid[:201, :201] - 100.0
    star = 0.5 + 0.2 * np.sin(24 * np.arctan2(rows, columns))
    assert star_contrast(star, 24, np.array([60.0, 90.0])) == pytest.approx([0.4, 0.4], rel=0.05)
