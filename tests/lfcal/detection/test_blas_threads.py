"""One BLAS thread during a calibration, and as many as before after it."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import lfcal
from lfcal.detection import downscale


def _threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_calibrate_works_with_one_blas_thread_and_leaves_two(monkeypatch):
    seen = []
    choose_block_size = downscale.choose_block_size

    def record_threads(image):
        seen.append(_threads())
        return choose_block_size(image)

    monkeypatch.setattr(downscale, "choose_block_size", record_threads)
    with threadpool_limits(2, "blas"):
        if _threads() != {2}:
            pytest.skip("no BLAS here whose threads can be set")
        with pytest.raises(lfcal.CalibrationError):
            lfcal.calibrate(np.full((64, 64), 7, np.uint8))
        assert seen == [{1}]
        assert _threads() == {2}
