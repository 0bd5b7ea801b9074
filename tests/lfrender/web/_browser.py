"""A headless Chromium for the tests of pages, where there is one."""

from __future__ import annotations

import base64
import shutil
import time
from itertools import pairwise

import numpy as np
import pytest

_CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
READY = "window.lightField"
RESTS = "lightField.pending === undefined && !lightField.moving && !lightField.gliding"
# WebGL without a graphics card; a container has no room for Chromium's own sandbox.
_OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=880,420",
)


def start_browser():
    """A Selenium driver of Chromium, or skips the test with the reason."""
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    program = next(filter(None, map(shutil.which, _CHROMIUM)), None)
    driver = shutil.which("chromedriver")
    if program is None or driver is None:
        pytest.skip(
            "no browser: neither Chromium nor its driver is installed (Debian: chromium, "
            "chromium-driver)"
        )
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for option in _OPTIONS:
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    browser.set_script_timeout(60)
    return browser


def errors(browser):
    """What the console holds that is worse than information."""
    return [
        entry["message"]
        for entry in browser.get_log("browser")
        if entry["level"] in ("SEVERE", "WARNING")
    ]


def wait_for(browser, condition, seconds=30):
    """Wait until a JavaScript expression holds."""
    end = time.monotonic() + seconds
    while not browser.execute_script(f"return Boolean({condition})"):
        assert time.monotonic() < end, f"{condition} does not come true: {errors(browser)}"
        time.sleep(0.02)


def pixels(browser, shape, affine, **settings):
    """(h, w, 3) uint8: what the viewer draws on the grid of a picture."""
    height, width = shape
    text = browser.execute_script(
        "const a = lightField.pixels(...arguments); let s = '';"
        "for (let n = 0; n < a.length; n += 8192)"
        "  s += String.fromCharCode(...a.subarray(n, n + 8192)); return btoa(s)",
        width,
        height,
        affine[:, 2].tolist(),
        float(affine[0, 0]),
        settings,
    )
    return np.frombuffer(base64.b64decode(text), np.uint8).reshape(height, width, 4)[..., :3]


def mouse(page, *steps):
    """Press at the first position on the canvas, move over the others, and release."""
    from selenium.webdriver import ActionChains

    canvas = page.find_element("id", "picture")
    middle = canvas.size["width"] / 2, canvas.size["height"] / 2
    chain = ActionChains(page, duration=20)
    chain.move_to_element_with_offset(
        canvas, *(round(p - m) for p, m in zip(steps[0], middle, strict=True))
    )
    chain.click_and_hold()
    for before, after in pairwise(steps):
        chain.move_by_offset(*(round(b - a) for a, b in zip(before, after, strict=True)))
    chain.release().perform()
