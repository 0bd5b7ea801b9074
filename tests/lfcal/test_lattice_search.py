"""The final fit of a candidate counts by how far it has moved."""

from __future__ import annotations

import numpy as np

import lfcal


def test_final_fit_that_runs_away_is_not_taken(shared):
    flat = lfcal.read_flat(shared("captures", "MiniGarden2.webp"))
    whole = lfcal.calibrate(flat).lattice
    height, width = flat.shape[:2]
    left = (width - 1400) // 2
    top = (height - 1120) // 2
    part = lfcal.calibrate(np.ascontiguousarray(flat[top : top + 1120, left : left + 1400])).lattice
    index = whole.to_index(part.centres() + np.array([left, top]))
    away = np.linalg.norm((index - np.rint(index)) @ whole.basis, axis=1)
    assert np.sqrt((away**2).mean()) < 0.05 * whole.pitch
