"""One BLAS thread during a calibration, and as many as before after it."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import lfcal
from lfcal.detection import downscale as reduction


def _threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_calibrate_works_with_one_blas_thread_and_leaves_two(monkeypatch):
    seen = []
    block_size = reduction.choose_block_size

    def noting(image):
        seen.append(_threads())
        return block_size(image)

    monkeypatch.setattr(reduction, "choose_block_size", noting)
    with threadpool_limits(2, "blas"):
        if _threads() != {2}:
            pytest.skip("no BLAS here whose threads can be set")
        with pytest.raises(lfcal.CalibrationError):
            lfcal.calibrate(np.full((64, 64), 7, np.uint8))
        assert seen == [{1}]
        assert _threads() == {2}
