"""Every doubt has one limit: below it nothing is said, beyond it what to do."""

from __future__ import annotations

import pytest

from lfcal.runtime import checks
from lfcal.runtime.checks import LIMITS


@pytest.mark.parametrize(
    ("find", "sure", "doubtful"),
    [
        (checks.find_lattice_doubt, (LIMITS.confidence, 0.1), (0.69, 0.1)),
        (checks.find_circle_doubt, (0.6, 0.89), (0.6, 0.91)),
        (checks.find_gain_doubt, (LIMITS.off_gain,), (0.031,)),
        (checks.find_exposure_doubt, (LIMITS.clipped,), (0.021,)),
        (checks.find_type_doubt, (3, True), (3, False)),
        (checks.find_centroid_doubt, (0.1,), (0.3,)),
        (checks.find_mosaic_doubt, (None,), ("GBRG",)),
        (checks.find_camera_doubt, (0.9, 0.06, 0.033, "middle"), (0.9, 0.0, 0.034, "middle")),
        (checks.find_depth_doubt, (0.96, 0.04, 0.03), (0.96, 0.04, 0.019)),
        (checks.find_depth_doubt, (0.9, 0.1, 0.05), (0.9, 0.1, 0.049)),
        (checks.find_board_doubt, (LIMITS.board_noise,), (6.1,)),
    ],
)
def test_doubts_begin_at_their_limit_and_say_what_to_do(find, sure, doubtful):
    assert find(*sure) is None
    assert len(str(find(*doubtful)).split()) > 8
