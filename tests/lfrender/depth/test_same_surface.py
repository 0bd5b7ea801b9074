"""The test of whether two patch sizes belong to one surface."""

import numpy as np
import pytest
from numba import njit

from lfrender.depth.same_surface import same_surface


@njit
def in_kernel(a, b, tolerance):
    out = np.empty(len(a), np.bool_)
    for k in range(len(a)):
        out[k] = same_surface(a[k], b[k], tolerance)
    return out


@pytest.mark.parametrize("test", [same_surface, in_kernel])
def test_patch_sizes_within_the_tolerance_are_one_surface(test):
    a = np.array([4.0, 4.0, 4.0, -4.0, np.nan], np.float32)
    b = np.array([4.5, 3.5, 4.6, 4.0, 4.0], np.float32)
    assert test(a, b, np.float32(0.5)).tolist() == [True, True, False, False, False]
