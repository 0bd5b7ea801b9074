"""Lenses that show something else than in the previous frame."""

from __future__ import annotations

import numpy as np

from lfrender.depth.changed_lenses import find_changed_lenses
from lfrender.depth.pipeline import prepare_flat
from lfrender.flat.texture import sample_statistics


def changed_lenses(before, now, calibration):
    before, now = (prepare_flat(flat, calibration, "balanced")[0] for flat in (before, now))
    return find_changed_lenses(before, sample_statistics(before), now)


def noisy(flat, seed):
    noise = np.random.default_rng(seed).normal(0, 2.0, flat.shape)
    return np.clip(np.rint(flat + noise), 0, 255).astype(np.uint8)


def test_a_motion_of_a_third_of_a_pixel_is_distinguished_from_noise(house):
    from scipy.ndimage import shift

    calibration = house.truth.calibration
    moved = np.rint(shift(house.flat.astype(float), (0, 0.33, 0), order=1, mode="nearest")).astype(
        np.uint8
    )
    changed = [
        changed_lenses(noisy(house.flat, k), noisy(moved, k + 1), calibration)
        for k in range(1, 17, 2)
    ]
    assert np.mean(changed) > 0.55
    assert changed_lenses(noisy(house.flat, 1), noisy(house.flat, 2), calibration).mean() < 0.003


def test_coding_noise_of_a_still_scene_is_no_change(house):
    calibration = house.truth.calibration
    coded = house.flat.astype(int)
    rng = np.random.default_rng(4)
    for y in range(0, coded.shape[0], 64):
        for x in range(0, coded.shape[1], 64):
            # Some blocks are coded anew, the others are skipped.
            if (x + y) // 64 % 2:
                block = coded[y : y + 64, x : x + 64]
                block += rng.integers(-1, 2, block.shape)
    coded = np.clip(coded, 0, 255).astype(np.uint8)
    assert changed_lenses(house.flat, coded, calibration).mean() < 0.02
