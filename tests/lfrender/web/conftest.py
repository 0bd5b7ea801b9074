"""The viewer of the house in a browser, for the tests of its picture and of its controls."""

from __future__ import annotations

from dataclasses import replace

import pytest

import lfcal
import lfrender
from lfrender.web.server import WebServer, page_routes
from lfrender.web.viewer import FlatPages

from ._browser import READY, errors, start_browser, wait_for


@pytest.fixture(scope="module")
def browser():
    driver = start_browser()
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def captured(house):
    """Flat, camera and depth of the house."""
    camera = house.truth.calibration
    return house.flat, camera, lfrender.analyze(house.flat, camera)


@pytest.fixture(scope="module")
def served(captured):
    """The viewer of the house on a server, in several tiles; its camera has optics, so that places
    have metres.
    """
    flat, camera, depth = captured
    optics = lfcal.Optics(focal_length=50, mla_distance=58, sensor_distance=0.7, pixel=0.005)
    scene = flat, replace(camera, optics=optics), depth
    with WebServer(page_routes(FlatPages(["house.png"], lambda _: scene, tile=256))) as server:
        yield server


@pytest.fixture
def page(browser, served):
    if browser.current_url.partition("#")[0] != served.url:
        browser.get(served.url)
        wait_for(browser, READY)
    browser.execute_script(
        "lightField.compare(false); lightField.other = undefined; lightField.measure(false);"
        "lightField.view('');"
        "lightField.set({ mode: 'focus', plane: lightField.scene.plane, q: [0, 0], aperture: 1,"
        "overlay: 0,"
        "brightness: 0 }); lightField.fit()"
    )
    yield browser
    assert errors(browser) == []
