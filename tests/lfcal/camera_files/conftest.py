"""Cameras for the tests of camera files."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal


@pytest.fixture(scope="session")
def make_camera():
    """Gives a camera for flats of 640 x 480 px, of a lattice shape at a pitch [px], rotated
    clockwise [degrees].
    """

    def make(shape, pitch, degrees, stretch=1.0, x=300.0, y=200.0):
        cos = np.cos(np.radians(degrees))
        sin = np.sin(np.radians(degrees))
        basis = pitch * np.asarray(shape) @ np.array([[cos, sin], [-sin, cos]]) * [stretch, 1]
        return lfcal.Calibration(lfcal.Lattice((x, y), basis, (640, 480), 0.45 * pitch))

    return make
