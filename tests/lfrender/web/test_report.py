"""The report: whole, self-contained, below 15 MB, and with the figures of depth map and
calibration.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from click.testing import CliRunner

import lfrender
from lfrender.cli.main import main
from lfrender.web.report import write_report
from lfrender.web.report_pictures import data_urls, draw_pictures

from ._browser import errors, start_browser, wait_for


class Page(HTMLParser):
    """Collects what a page refers to, its text, and the numbers that its elements carry."""

    def __init__(self, text):
        super().__init__()
        self.sources, self.text, self.nameless, self.titles = [], "", [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.sources += [value for name, value in attrs if name in ("src", "href")]
        if tag == "img" and "alt" not in attributes:
            self.nameless.append(attributes)

    def handle_data(self, data):
        self.text += data


@pytest.fixture(scope="module")
def captured(house):
    camera = house.truth.calibration
    return house.flat, camera, lfrender.analyze(house.flat, camera)


@pytest.fixture(scope="module")
def pictures(captured):
    return draw_pictures(*captured)


@pytest.fixture(scope="module")
def report(captured, pictures, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    flat, camera, depth = captured
    camera = replace(camera, warnings=("the lamp <flickers>",))
    write_report(
        path,
        flat,
        camera,
        depth,
        pictures,
        title="A & B.png",
        seconds={"read": 0.25, "analyze": 1.5},
    )
    return path


def test_the_page_is_small_and_needs_nothing_but_itself(report):
    text = report.read_text(encoding="utf-8")
    page = Page(text)
    assert len(text) < 15_000_000
    assert len(page.sources) >= 8
    assert all(source.startswith("data:") for source in page.sources)
    assert "url(http" not in text
    assert page.nameless == []


def test_the_page_has_warnings_times_and_shares(report, captured):
    text = report.read_text(encoding="utf-8")
    page = Page(text)
    depth = captured[2]
    assert "The lamp <flickers>" in page.text
    assert "<flickers>" not in text
    assert "A & B.png" in page.text
    assert "1.50 s" in page.text
    assert f"telescopic {np.mean(depth.mode == 1):.1%}" in page.text
    assert f"{np.mean(depth.reason == 1):.2%} of the lenses" in page.text


def test_the_raw_flat_comes_first_and_the_comparison_opens_with_the_traditional_picture(report):
    text = report.read_text(encoding="utf-8")
    sections = re.findall(r'<section aria-labelledby="(\w+)"', text)
    assert sections[:4] == ["flat", "pictures", "depth", "calibrated"]
    assert re.findall(r'data-choice="(\w+)" aria-pressed="true"', text) == ["traditional"]
    page = Page(text).text
    # Terms are explained where they appear.
    for words in (
        "a microimage, a small view",
        "the pitch D = 20.3 px",
        "the patch size s",
        "Magnification M = D / |s|",
    ):
        assert words in " ".join(page.split())


@pytest.mark.filterwarnings("ignore:next to no lenses are resolved:UserWarning")
def test_a_depth_map_without_any_depth_has_a_report_too(captured, tmp_path):
    flat, camera, depth = captured
    blank = replace(
        depth, patch_size=np.full(len(depth), np.nan, np.float32), reason=None, saved={}
    )
    write_report(tmp_path / "report.html", flat, replace(camera, confidence=0.2), blank)
    text = Page((tmp_path / "report.html").read_text(encoding="utf-8")).text
    assert "100% of the lenses have no depth of their own" in text
    assert "doubtful (confidence 20 %)" in text


def test_pictures_that_do_not_fit_lose_quality_first_and_size_then():
    noise = np.random.default_rng(1).integers(0, 256, (600, 800, 3), np.uint8)
    pictures = {"all": noise, "traditional": noise[:20, :30]}
    best, size = data_urls(pictures, 10**9)
    room = sum(map(len, best.values()))
    assert size == 1
    coarser, size = data_urls(pictures, room - 1)
    assert (size, sum(map(len, coarser.values())) < room) == (1, True)
    small, size = data_urls(pictures, room // 8)
    assert size < 1
    assert sum(map(len, small.values())) <= room // 8
    # What is small already stays.
    assert len(small["traditional"]) > 0.5 * len(best["traditional"])


def test_one_channel_is_shown():
    grey = np.full((40, 50), 156, np.uint8)
    urls, _ = data_urls({"grey": grey}, 10**6)
    import base64

    import cv2

    data = np.frombuffer(base64.b64decode(urls["grey"].split(",")[1]), np.uint8)
    np.testing.assert_allclose(cv2.imdecode(data, cv2.IMREAD_COLOR), 156, atol=1.5)


def test_the_command_writes_a_report_and_its_figures(house_files, captured, tmp_path):
    captured[2].save(tmp_path / "depth.npz")
    output = tmp_path / "report.html"
    arguments = [
        "report",
        str(house_files / "flat.png"),
        "-c",
        str(house_files / "camera.json"),
        "-o",
        str(output),
    ]
    result = CliRunner().invoke(
        main, [*arguments, "--depth", str(tmp_path / "depth.npz"), "--json"]
    )
    assert result.exit_code == 0, result.output
    figures = json.loads(result.stdout)
    assert figures["modes"]["telescopic"] == pytest.approx(np.mean(captured[2].mode == 1))
    assert output.exists()
    refused = CliRunner().invoke(main, [*arguments[:-1], str(tmp_path / "report.pdf")])
    assert refused.exit_code == 2
    assert ".html" in refused.stderr


def test_the_line_moves_and_the_picture_zooms_to_its_own_pixels(report):
    browser = start_browser()
    try:
        browser.get(report.as_uri())
        wait_for(
            browser,
            "document.getElementById('left').complete && document.getElementById('right').complete",
        )
        size = browser.execute_script(
            "const i = document.querySelector('#sources img');"
            "return i.decode().then(() => [i.naturalWidth, i.naturalHeight])"
        )
        line = browser.find_element("id", "line")
        style = "getComputedStyle(document.getElementById('right'))"
        cut = f"return parseFloat({style}.clipPath.split(' ')[3])"
        assert browser.execute_script(cut) == pytest.approx(50, abs=0.2)
        browser.execute_script(
            "arguments[0].value = 20; arguments[0].dispatchEvent(new Event('input'))", line
        )
        assert browser.execute_script(cut) == pytest.approx(20, abs=0.2)
        browser.find_element("id", "full").click()
        assert (
            browser.execute_script(
                "const s = document.getElementById('sheet'); return [s.clientWidth, s.clientHeight]"
            )
            == size
        )
        browser.find_element("css selector", "[data-choice=traditional]").click()
        assert browser.find_element("id", "name").text == "traditional"
        browser.find_element("id", "fit").click()
        # No sideways scrolling on a narrow screen, of the page or of anything on it.
        for width in (390, 800):
            browser.execute_cdp_cmd(
                "Emulation.setDeviceMetricsOverride",
                {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": False},
            )
            wide = browser.execute_script(
                "return [...document.querySelectorAll(':not(svg *)')].filter(e => e.clientWidth && "
                "e.scrollWidth > e.clientWidth + 1 && "
                "getComputedStyle(e).overflowX !== 'visible' || "
                "e.getBoundingClientRect().right > innerWidth + 1)"
                ".map(e => e.tagName + e.className)"
            )
            assert wide == [], width
        # Nothing of the flat is cut off, no caption is a name alone, and figures can be read.
        flat = "document.querySelector('img.map')"
        assert browser.execute_script(f"return getComputedStyle({flat}).objectFit") == "contain"
        captions = browser.execute_script(
            "return [...document.querySelectorAll('figcaption')].map(e => e.textContent.trim())"
        )
        assert min(len(caption.split()) for caption in captions) > 4
        ink = browser.execute_script(
            "return document.querySelector('.chart #text_1').getBoundingClientRect().height"
        )
        assert ink > 6
        assert errors(browser) == []
    finally:
        browser.quit()
