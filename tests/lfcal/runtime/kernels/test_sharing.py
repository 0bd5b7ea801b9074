"""Items of a loop are worked on once each, by as many threads as Numba may use."""

from __future__ import annotations

import threading

import numba
import numpy as np
import pytest

from lfcal.runtime.kernels.jit import kernel
from lfcal.runtime.kernels.sharing import share_out


@pytest.fixture(params=[1, 2])
def threads(request):
    before = numba.get_num_threads()
    if request.param > numba.config.NUMBA_NUM_THREADS:
        pytest.skip("one thread only")
    numba.set_num_threads(request.param)
    yield request.param
    numba.set_num_threads(before)


@pytest.mark.parametrize("items", [0, 1, 5, 1000])
def test_each_item_is_worked_on_once(threads, items):
    seen = np.zeros(items, int)
    workers = set()

    def work(begin, end, out):
        out[begin:end] += 1
        workers.add(threading.get_ident())

    share_out(work, items, (seen,))
    assert (seen == 1).all()
    assert len(workers) <= threads


def test_errors_of_all_threads_are_raised(threads):
    def work(begin, end):
        if end == 100:
            raise ValueError("the last item")

    with pytest.raises(ValueError, match="the last item"):
        share_out(work, 100, ())


def test_a_kernel_gets_its_part_as_first_arguments(threads):
    @kernel(share=lambda values, out: len(values))
    def double(begin, end, values, out):
        for k in range(begin, end):
            out[k] = 2 * values[k]

    out = np.zeros(50)
    double(np.arange(50.0), out)
    assert (out == 2 * np.arange(50)).all()
