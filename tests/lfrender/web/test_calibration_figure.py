"""The panels of the calibration: circles on the microimages, offsets with a verdict, the light of a
microimage.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import lfcal
from lfrender.web.calibration_figure import calibration_panels


@pytest.fixture(scope="module")
def panels(house):
    return calibration_panels(house.white, house.truth.calibration)


def test_circles_are_those_of_the_lattice_in_pixels_of_the_flat(house, panels):
    lattice = house.truth.calibration.lattice
    found = np.array(
        re.findall(r'<circle cx="([-\d.]+)" cy="([-\d.]+)" r="([\d.]+)" stroke', panels), float
    )
    nearest = np.linalg.norm(found[:, None, :2] - lattice.centres(), axis=2).min(1)
    assert len(found) > 60 and nearest.max() < 0.01
    assert found[:, 2] == pytest.approx(lattice.radius, abs=0.01)


def test_the_verdict_says_whether_to_worry(house):
    white = house.white
    camera = house.truth.calibration
    good = lfcal.check_fit(camera, white)
    assert good.warning is None and "no reason to worry" in good.verdict
    assert good.limit == pytest.approx(max(0.04 * camera.lattice.pitch, 0.0), rel=0.5)
    beside = replace(camera, lattice=replace(camera.lattice, origin=camera.lattice.origin + 2.0))
    bad = lfcal.check_fit(beside, white)
    assert bad.warning is not None and "or calibrate on it" in bad.verdict
    assert "or calibrate on it" in calibration_panels(white, beside)
