"""The panels of the calibration: circles on the microimages, offsets with a verdict, the light of a microimage."""

from __future__ import annotations

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

import lfcal
from lfrender.web.calibration_figure import calibration_panels, enlarged_crop


@pytest.fixture(scope="module")
def panels(house):
    return calibration_panels(house.white, house.truth.calibration)


def test_circles_are_those_of_the_lattice_in_pixels_of_the_flat(house, panels):
    lattice = house.truth.calibration.lattice
    found = np.array(re.findall(r'<circle cx="([-\d.]+)" cy="([-\d.]+)" r="([\d.]+)" stroke', panels), float)
    nearest = np.linalg.norm(found[:, None, :2] - lattice.centres(), axis=2).min(1)
    assert len(found) > 60 and nearest.max() < 0.01
    assert found[:, 2] == pytest.approx(lattice.radius, abs=0.01)


def test_every_panel_is_a_figure_with_a_caption_and_a_name(panels):
    page = ElementTree.fromstring(f"<div>{panels}</div>")
    figures = page.findall("figure")
    assert len(figures) >= 5
    assert all(figure.find("figcaption").find("b").text for figure in figures)
    assert all(figure.find("svg").get("aria-label") for figure in figures if figure.find("svg") is not None)


def test_the_verdict_says_whether_to_worry(house):
    white, camera = house.white, house.truth.calibration
    good = lfcal.check_fit(camera, white)
    assert good.warning is None and "no reason to worry" in good.verdict
    assert good.limit == pytest.approx(max(0.04 * camera.lattice.pitch, 0.0), rel=0.5)
    beside = replace(camera, lattice=replace(camera.lattice, origin=camera.lattice.origin + 2.0))
    bad = lfcal.check_fit(beside, white)
    assert bad.warning is not None and "calibrate on this flat" in bad.verdict
    assert "calibrate on this flat" in calibration_panels(white, beside)


def test_a_crop_at_the_border_stays_within_the_flat(house):
    height, width = house.flat.shape[:2]
    corner = enlarged_crop(house.flat, np.array([0.0, 1e4]), 90)
    x, y, across, down = map(float, re.search(r'viewBox="([-\d.]+) ([-\d.]+) (\d+) (\d+)"', corner).groups())
    assert (x, y, across, down) == (-0.5, height - 90.5, 90, 90)
    assert "data:image/webp" in enlarged_crop(house.flat[..., 0].astype(np.uint16) * 200, np.array([width, 0.0]), 50)
