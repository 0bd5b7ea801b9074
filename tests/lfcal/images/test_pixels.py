"""Arrays and decoded files in the one form that all functions read, or one line."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import lfcal

GREY = np.arange(20 * 30, dtype=np.uint16).reshape(20, 30)


def test_alpha_is_dropped():
    rgb = np.dstack([GREY, GREY + 1, GREY + 2])
    np.testing.assert_array_equal(lfcal.check_pixels(np.dstack([rgb, GREY * 0])), rgb)
    np.testing.assert_array_equal(lfcal.check_pixels(np.dstack([GREY, GREY * 0])), GREY)


@pytest.mark.parametrize("dtype", [">u2", "<u2", "u4", "i8", ">i4"])
def test_integers_of_any_width_and_byte_order_become_native_16_bits(dtype):
    flat = lfcal.check_pixels(GREY.astype(dtype))
    assert flat.dtype == np.uint16 and flat.dtype.isnative
    np.testing.assert_array_equal(flat, GREY)


def test_signed_values_below_zero_become_zero():
    flat = lfcal.check_pixels(GREY.astype(np.int16) - 100)
    np.testing.assert_array_equal(flat, np.maximum(GREY.astype(int) - 100, 0))


@pytest.mark.parametrize(
    ("array", "reason"),
    [
        (np.ma.masked_less(GREY, 5), "5 values are masked"),
        (np.where(GREY == 7, np.nan, 1.0), "1 values are NaN or infinite, the first at x=7, y=0"),
        (np.full((20, 30), 1e300), "scale them to at most 1e"),
        (np.full((20, 30), -0.5), "negative values only"),
        (np.full((20, 30), -3), "negative values only"),
        (np.full((20, 30), 1e31), "at most 1e"),
        (GREY.astype(np.uint32) + 65535, "above 65535"),
        (GREY.astype(complex), "type complex128"),
        (np.zeros((20, 30, 5)), "shape"),
        (np.zeros((0, 5)), "shape"),
        (np.zeros(8), "shape"),
    ],
)
def test_an_array_that_cannot_be_a_flat_is_refused_with_the_reason(array, reason):
    with pytest.raises(lfcal.FlatError, match=reason):
        lfcal.check_pixels(array)


def test_an_unmasked_masked_array_is_a_flat():
    np.testing.assert_array_equal(lfcal.check_pixels(np.ma.masked_less(GREY, 0)), GREY)


@example(np.array([[3.40282357e38, -3.40282357e38]]))
@given(
    arrays.arrays(
        st.one_of(arrays.scalar_dtypes(), st.just(np.dtype("U3"))),
        arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=6),
    )
)
def test_any_array_gives_a_flat_or_one_line(array):
    try:
        flat = lfcal.check_pixels(array)
    except lfcal.FlatError as error:
        assert "\n" not in str(error)
    else:
        assert flat.dtype in (np.uint8, np.uint16, np.float32) and flat.dtype.isnative
        assert flat.shape[2:] in ((), (3,)) and flat.shape[:2] == array.shape[:2]
        assert np.isfinite(flat).all()
