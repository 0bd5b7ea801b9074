"""The demo: runs whole, shows what it promises, and its figures are those of a working chain."""

from __future__ import annotations

import os
import re
from html.parser import HTMLParser

import pytest

import lfcal
from lfrender.web.demo import run_demo

from ._browser import start_browser

PICTURES = [
    "all_in_focus",
    "binocular",
    "depth",
    "flat",
    "flat_crop",
    "modes",
    "reference",
    "telescopic",
]


class Page(HTMLParser):
    """Collects what a page refers to."""

    def __init__(self):
        super().__init__()
        self.sources, self.text, self.open = [], "", []

    def handle_starttag(self, tag, attrs):
        self.sources += [value for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data):
        self.text += data


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo") / "made" / "here"
    return folder, run_demo(folder, flat_size=(600, 460), samples=8)


def test_all_pictures_and_the_page_are_written(demo):
    folder, _ = demo
    assert sorted(os.listdir(folder)) == sorted(
        [f"{name}.png" for name in [*PICTURES, "traditional"]] + ["index.html"]
    )
    sizes = {name: lfcal.read_flat(folder / f"{name}.png").shape[:2] for name in PICTURES}
    assert sizes["all_in_focus"] == sizes["reference"] == sizes["telescopic"] == sizes["binocular"]


def test_page_needs_nothing_but_itself(demo):
    folder, figures = demo
    page = Page()
    page.feed((folder / "index.html").read_text(encoding="utf-8"))
    assert len(page.sources) >= 8
    assert all(
        source.startswith(("data:image/png;base64,", "data:image/webp;base64,", "data:,"))
        for source in page.sources
    )
    assert f"{figures['merit']['all_in_focus']['psnr']:.1f} dB" in page.text
    assert not re.search(r"\$[a-z]", page.text)


def test_the_page_fits_a_phone(demo):
    browser = start_browser()
    try:
        browser.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": 390, "height": 800, "deviceScaleFactor": 1, "mobile": False},
        )
        browser.get((demo[0] / "index.html").as_uri())
        assert browser.execute_script("return document.documentElement.scrollWidth") <= 390
    finally:
        browser.quit()


def test_figures_are_those_of_a_working_chain(demo):
    _, figures = demo
    merit = figures["merit"]
    assert (
        merit["all_in_focus"]["psnr"]
        > max(merit["telescopic"]["psnr"], merit["binocular"]["psnr"]) + 2
    )
    assert (
        merit["all_in_focus"]["ssim"]
        > max(merit["telescopic"]["ssim"], merit["binocular"]["ssim"]) + 0.1
    )
    assert figures["mode_right"]["one_depth"] > 0.75
    assert figures["mode_wrong"]["one_depth"] < 0.1
    assert figures["magnification_error"]["one_depth"] < 0.05
    for kind in ("scene", "white"):
        assert figures["calibration"][kind]["centre_error"] < 0.2
    assert figures["fixed_patch_size"]["telescopic"] > 0 > figures["fixed_patch_size"]["binocular"]
    assert figures["seconds"]["analyze"] > 0
