"""The live page in a browser: the slider of planes, and the depth under the pointer."""

from __future__ import annotations

import re
import threading
from dataclasses import replace

import numpy as np
import pytest

import lfcal
from lfrender.live.grabber import Grabber
from lfrender.live.server import LiveServer
from lfrender.live.session import Session
from lfrender.live.sources import Shot

from ..web._browser import errors, start_browser, wait_for


@pytest.fixture(scope="module")
def browser():
    driver = start_browser()
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def live(house, house_white_camera, tmp_path_factory):
    """A session of a camera with optics that shows the house, and its server."""
    optics = lfcal.Optics(focal_length=50, mla_distance=58, sensor_distance=0.7, pixel=0.005)
    camera = replace(house_white_camera, optics=optics)
    ended = threading.Event()

    def source():
        yield Shot(house.flat)
        ended.wait()

    session = Session(
        Grabber(source), lambda shot: camera, "fast", tmp_path_factory.mktemp("live"), given=True
    )
    session.start(strict=True)
    with LiveServer(session, "house.png") as server:
        yield session, server
    ended.set()
    session.close()


@pytest.fixture(params=[1280, 390])
def page(request, browser, live):
    """The page in a window of a desk and of a phone, once it shows a picture."""
    from selenium.webdriver import ActionChains

    session, server = live
    browser.set_window_size(1280, 800)
    # Windows of a headless browser have at least 500 px.
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": request.param, "height": 800, "deviceScaleFactor": 1, "mobile": False},
    )
    browser.get(server.url)
    wait_for(browser, "document.getElementById('picture').naturalWidth")
    wait_for(browser, "!document.getElementById('plane').disabled")
    yield browser, session
    ActionChains(browser).reset_actions()
    assert errors(browser) == []


def point_at(browser, place, click=False):
    """Move the mouse to a place of the picture, as shares of width and height."""
    from selenium.webdriver import ActionChains

    picture = browser.find_element("id", "picture")
    size = browser.execute_script(
        "const p = document.getElementById('picture'), b = p.getBoundingClientRect();"
        "const k = Math.min(b.width / p.naturalWidth, b.height / p.naturalHeight);"
        "return [k * p.naturalWidth, k * p.naturalHeight]"
    )
    offset = [round(length * (share - 0.5)) for length, share in zip(size, place, strict=True)]
    chain = ActionChains(browser, duration=20).move_to_element_with_offset(picture, *offset)
    (chain.click() if click else chain).perform()
    return [0.5 + moved / length for moved, length in zip(offset, size, strict=True)]


def text(browser, name):
    return browser.execute_script(f"return document.getElementById('{name}').textContent")


def patch_size(words):
    """The figure after `s` in the words of the page [px]."""
    sign, value = re.search(r"s ([+−])([\d.]+) px", words).groups()
    return float(value) * (-1 if sign == "−" else 1)


def test_the_slider_sets_the_plane_and_a_click_sets_the_slider(page):
    browser, session = page
    seen = {}
    for end in ("min", "max"):
        before = browser.execute_script("return document.getElementById('picture').src")
        browser.execute_script(
            f"const p = document.getElementById('plane'); p.value = p.{end};"
            "p.dispatchEvent(new Event('input'))"
        )
        wait_for(browser, f"document.getElementById('picture').src !== '{before}'")
        assert browser.find_element("css selector", "input[value=focus]").is_selected()
        focus, seen[end] = session.view.jpegs["focus"]
        assert focus == pytest.approx(patch_size(text(browser, "plane-value")), abs=0.006)
    assert seen["min"] != seen["max"]

    place = point_at(browser, (0.3, 0.6), click=True)
    size = session.view.patch_size(tuple(place))
    words = f"s {'+' if size > 0 else '−'}{abs(size):.2f} px"
    wait_for(browser, f"document.getElementById('plane-value').textContent.includes('{words}')")
    near = size if size > 0 else size + 2 * session.view.camera.lattice.pitch
    shown = float(browser.execute_script("return document.getElementById('plane').value"))
    assert shown == pytest.approx(near, abs=1e-3)


def test_the_depth_under_the_pointer_is_shown_and_goes_with_it(page):
    browser, session = page
    depth, camera = session.view.depth, session.view.camera
    resolved = np.flatnonzero(~depth.filled & (depth.confidence > 0.9))
    centre = camera.lattice.centres()[resolved[len(resolved) // 2]]
    place = point_at(browser, (centre + 0.5) / camera.image_size)
    wait_for(browser, "document.getElementById('readout').textContent.includes('sure')")
    known = session.view.depth_at(tuple(place))
    words = text(browser, "readout")
    assert patch_size(words) == pytest.approx(known["patch_size"], abs=0.3)
    assert f"{100 * known['confidence']:.0f} % sure" in words
    assert words.endswith(" away") and known["distance"] > 0
    box = browser.execute_script(
        "return document.getElementById('readout').getBoundingClientRect().right"
    )
    assert box <= browser.execute_script("return innerWidth")
    point_at(browser, (0.5, 0.5))
    browser.execute_script(
        "document.getElementById('picture').dispatchEvent("
        "new PointerEvent('pointerleave', { pointerType: 'mouse' }))"
    )
    wait_for(browser, "document.getElementById('readout').textContent === ''")


def test_the_page_is_no_wider_than_its_window(page):
    browser, _ = page
    width, inner = browser.execute_script(
        "return [document.documentElement.scrollWidth, innerWidth]"
    )
    assert width <= inner
    right = browser.execute_script(
        "return document.getElementById('plane').getBoundingClientRect().right"
    )
    assert right <= inner
