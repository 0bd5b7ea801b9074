"""Every control of the viewer does what it says, and is off where it would do nothing."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
import pytest

import lfrender
from lfrender.web.viewer_scene import _planes

from ._browser import READY, RESTS, errors, mouse, pixels, start_browser, wait_for

GRID = np.array([[4.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
SHAPE = (100, 132)


# Few pixels, since there is no graphics card.
SCREEN = {"width": 880, "height": 420, "deviceScaleFactor": 0.5, "mobile": False}
PHONE = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}


@pytest.fixture(scope="module")
def browser():
    driver = start_browser()
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", SCREEN)
    yield driver
    driver.quit()


def settings(page):
    return page.execute_script("return lightField.settings")


def slide(page, name, value):
    page.execute_script(
        "const s = document.getElementById(arguments[0]); s.value = arguments[1];"
        "s.dispatchEvent(new Event('input'))",
        name,
        value,
    )


def shown(page, name):
    return page.find_element("id", name).text


def is_off(page, name):
    return page.execute_script("return document.getElementById(arguments[0]).disabled", name)


def choose(page, mode):
    page.execute_script("document.querySelector(`input[value=${arguments[0]}]`).click()", mode)


def picture(page, **changed):
    return pixels(page, SHAPE, GRID, **changed).astype(float)


def test_the_page_opens_in_focus_on_the_depth_that_most_lenses_share_with_a_hint(
    browser, served, captured
):
    browser.get("about:blank")
    browser.get(served.url)
    wait_for(browser, READY)
    assert shown(browser, "status") == "Click to focus there. Drag to look from aside."
    depth = captured[2]
    plane = browser.execute_script("return lightField.settings.plane")
    assert plane == pytest.approx(_planes(depth)[1])
    known = depth.patch_size[~depth.filled]
    sure = depth.confidence[~depth.filled]
    within = [
        sure[np.abs(known - s) < 0.03 * depth.pitch].sum()
        for s in (plane, *np.quantile(known, (0.1, 0.5, 0.9)))
    ]
    assert within[0] == max(within) > 0.1 * sure.sum()
    mouse(browser, (200, 200))
    assert shown(browser, "status") == ""


def test_sliders_set_what_they_name_and_say_so(page):
    low, high = page.execute_script("return lightField.scene.planes")
    pitch = page.execute_script("return lightField.scene.pitch")
    near = low + 0.9 * (high - low)
    slide(page, "plane", near)
    assert settings(page)["plane"] == pytest.approx(near - 2 * pitch if near > pitch else near)
    assert shown(page, "plane-value").startswith("binocular, M ") and " s −" in shown(
        page, "plane-value"
    )
    slide(page, "aperture", 0.5)
    slide(page, "brightness", -1.5)
    assert (settings(page)["aperture"], settings(page)["brightness"]) == (0.5, -1.5)
    assert (shown(page, "aperture-value"), shown(page, "brightness-value")) == ("50 %", "−1.5 EV")


def test_a_range_is_sharp_within_and_out_of_focus_beyond(page, captured):
    choose(page, "range")
    assert not page.find_element("id", "one-depth").is_displayed()
    low, high = page.execute_script("return lightField.scene.planes")
    pitch = page.execute_script("return lightField.scene.pitch")
    sharp = picture(page, mode="sharp")
    width = high - low
    whole = picture(page, mode="range", range=[low, high])
    # Other weights at depth edges and in places without a depth.
    assert np.mean(np.abs(whole - sharp).max(-1) <= 2) > 0.97
    far = picture(page, mode="range", range=[low, low + 0.3 * width])
    end = low + 0.3 * width
    beyond = picture(page, mode="focus", plane=end if end < pitch else end - 2 * pitch)
    surface = captured[2].surface
    v, u = np.indices(SHAPE)
    s = surface.at(np.column_stack([u.ravel(), v.ravel()]) @ GRID[:, :2]).reshape(SHAPE)
    near = np.where(s > 0, s, s + 2 * pitch)
    inside, outside = (
        cv2.erode(m.astype(np.uint8), np.ones((7, 7))) > 0 for m in (near < end, near > end)
    )
    assert inside.any() and outside.any()
    assert np.mean(np.abs(far - sharp).max(-1)[inside] <= 2) > 0.95
    assert np.mean(np.abs(far - beyond).max(-1)[outside] <= 2) > 0.95


def test_depth_is_laid_over_the_picture_with_its_legend(page):
    page.find_element("id", "overlay").click()
    assert settings(page)["overlay"] == 0.6 and page.find_element("id", "legend").is_displayed()
    assert np.abs(picture(page) - picture(page, overlay=0)).mean() > 10  # grey levels


def test_the_place_under_the_pointer_is_described_with_its_distance(page, captured):
    from selenium.webdriver import ActionChains

    canvas = page.find_element("id", "picture")
    found = []
    for x in (-60, -20, 20, 60):
        ActionChains(page, duration=10).move_to_element_with_offset(canvas, x, 40).perform()
        found.append(shown(page, "readout"))
    assert all(
        words == "no depth of its own here"
        or (words.startswith(("telescopic, M ", "binocular, M ")) and "% sure" in words)
        for words in found
    )
    assert any(" away" in words for words in found)  # the optics of the page are known


def test_two_places_have_a_distance_in_metres_where_the_optics_are_known(page):
    page.find_element("id", "measure").click()
    assert shown(page, "status") == "Click two places."
    mouse(page, (180, 200))
    mouse(page, (260, 230))
    wait_for(page, RESTS)
    marks = page.execute_script("return lightField.marks")
    apart = np.subtract(marks[1]["position"], marks[0]["position"])
    metres = np.linalg.norm(apart)
    words = shown(page, "status")
    number, unit = words.split()[:2]
    assert float(number) * {"mm": 1e-3, "m": 1}[unit] == pytest.approx(metres, rel=0.01)
    assert page.execute_script("return document.querySelectorAll('#marks circle').length") == 2
    page.execute_script(
        "lightField.marks = [lightField.marks[0]]; delete lightField.marks[0].position"
    )
    mouse(page, (300, 100))
    assert "px apart on the flat, from M " in shown(page, "status")
    page.find_element("id", "measure").click()
    wait_for(page, f"{RESTS} && !document.getElementById('marks').innerHTML")
    assert shown(page, "status") == ""


def test_both_eyes_see_the_picture_side_by_side_or_in_colours(page):
    radius = page.execute_script("return lightField.scene.radius")
    page.execute_script(
        "const s = document.getElementById('stereo'); s.value = 'side';"
        "s.dispatchEvent(new Event('change'))"
    )
    assert settings(page)["stereo"] == "side"
    page.execute_script("lightField.set({ mode: 'sharp' })")
    side = picture(page, stereo="side")
    eyes = [picture(page, stereo="", q=[x * 0.35 * radius, 0]) for x in (-1, 1)]
    half = SHAPE[1] // 2
    left = (SHAPE[1] - SHAPE[1] // 2) // 2
    for k, eye in enumerate(eyes):
        assert np.abs(side[:, k * half : (k + 1) * half] - eye[:, left : left + half]).max() <= 1
    red = picture(page, stereo="anaglyph")[..., 0]
    cyan = picture(page, stereo="anaglyph")[..., 1:]
    assert np.abs(red - eyes[0][..., 0]).max() <= 1 and np.abs(cyan - eyes[1][..., 1:]).max() <= 1


def test_compare_starts_with_the_sharp_picture_beside_the_traditional_one(page, captured):
    flat, camera, _ = captured
    page.find_element("id", "compare").click()
    assert page.find_element("id", "line").text.split("\n") == [
        "A sharp everywhere",
        "B traditional",
    ]
    assert page.execute_script(
        "return [lightField.settings.mode, lightField.comparison().mode]"
    ) == [
        "sharp",
        "traditional",
    ]
    plain = lfrender.traditional(flat, camera)
    drawn = pixels(page, plain.image.shape[:2], plain.affine, mode="traditional").astype(int)
    assert np.abs(drawn - plain.image).max() <= 1


def test_a_view_is_compared_with_the_one_that_was_kept(page):
    page.execute_script("lightField.set({ plane: lightField.scene.planes[0], aperture: 0.4 })")
    page.find_element("id", "keep").click()
    assert (
        page.find_element("id", "compare").is_selected()
        and page.find_element("id", "line").is_displayed()
    )
    slide(page, "aperture", 1)
    wait_for(page, RESTS)
    page.execute_script("lightField.draw()")
    shot = page.find_element("id", "picture").screenshot_as_png
    both = cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR)[..., ::-1].astype(float)
    first, spacing = page.execute_script(
        "const v = lightField; return [v.frame.first(v.width, v.height), v.frame.spacing]"
    )
    affine = np.column_stack([np.eye(2) * spacing, first])
    views = [
        pixels(page, both.shape[:2], affine, aperture=aperture).astype(float)
        for aperture in (1, 0.4)
    ]
    middle = both.shape[1] // 2
    for view, columns in zip(views, (slice(30, middle - 15), slice(middle + 15, -30)), strict=True):
        part = np.s_[30:-60, columns]
        shown_here = view[part].any(-1)
        assert np.abs(both[part] - view[part])[shown_here].mean() < 0.5
    assert np.abs(views[0] - views[1]).mean() > 1


def test_a_link_shows_the_same_view(page, served):
    page.execute_script(
        "lightField.set({ mode: 'range', range: [5, 9], plane: 6.5, aperture: 0.6, q: [1.5, -2],"
        "overlay: 0.6,"
        "brightness: 0.4 }); lightField.zoom(2)"
    )
    wait_for(page, "location.hash.includes('view=')")
    before = page.execute_script(
        "return [lightField.settings, lightField.frame.middle, lightField.frame.spacing]"
    )
    link = page.current_url
    page.get("about:blank")
    page.get(link)
    wait_for(page, READY)
    after = page.execute_script(
        "return [lightField.settings, lightField.frame.middle, lightField.frame.spacing]"
    )
    for name in ("mode", "range", "plane", "aperture", "q", "overlay", "brightness", "stereo"):
        expected = before[0][name]
        assert after[0][name] == (
            expected if isinstance(expected, str) else pytest.approx(expected, rel=1e-4)
        ), name
    assert after[1] == pytest.approx(before[1], rel=1e-4) and after[2] == pytest.approx(
        before[2], rel=1e-4
    )
    # What makes no sense is left out.
    page.get("about:blank")
    page.get(f"{served.url}#mode=best&s=much&q=1&view=0,0,-1&brightness=99")
    wait_for(page, READY)
    opened = settings(page)
    assert (opened["mode"], opened["q"], opened["brightness"]) == ("focus", [0, 0], 3)


def downloaded(page, folder, name):
    page.execute_cdp_cmd(
        "Browser.setDownloadBehavior", {"behavior": "allow", "downloadPath": str(folder)}
    )
    page.find_element("id", name).click()
    end = time.monotonic() + 60
    while not (
        files := [path for path in Path(folder).iterdir() if not path.name.endswith(".crdownload")]
    ):
        assert time.monotonic() < end, shown(page, "status")
        time.sleep(0.05)
    return files[0]


def test_a_picture_is_saved_at_full_resolution_under_a_telling_name(page, captured, tmp_path):
    scale, size = page.execute_script("return [lightField.scene.scale, lightField.scene.size]")
    page.execute_script("lightField.set({ plane: 6.09, q: [3, 0] })")
    file = downloaded(page, tmp_path, "save")
    pitch = captured[1].lattice.pitch
    aside = round(100 * 3 / page.execute_script("return lightField.scene.radius"))
    assert file.name == f"house_focus-M{pitch / 6.09:.2f}-telescopic_view+{aside}+0.png"
    saved = cv2.imread(str(file))
    assert list(saved.shape[1::-1]) == [round(n * scale / pitch) for n in size]
    assert page.find_element("id", "save").text == "Save as PNG, {1} × {0} px".format(*saved.shape)
    spacing = pitch / scale
    affine = np.array([[spacing, 0, spacing / 2 - 0.5], [0, spacing, spacing / 2 - 0.5]])
    assert np.abs(saved[..., ::-1].astype(int) - pixels(page, saved.shape[:2], affine)).max() <= 1


def test_a_film_is_recorded(page, tmp_path):
    if is_off(page, "film"):
        pytest.skip("this browser records no films")
    # Small, since there is no graphics card.
    page.execute_script("lightField.zoom(4); document.getElementById('film-kind').value = 'focus'")
    file = downloaded(page, tmp_path, "film")
    assert file.name.startswith("house_focus-") and file.name.endswith(
        ("_focus.webm", "_focus.mp4")
    )
    film = cv2.VideoCapture(str(file))
    frames = []
    while (read := film.read())[0]:
        frames.append(read[1].astype(float))
    assert len(frames) >= 20
    changes = [np.abs(a - frames[0]).mean() for a in frames]
    assert max(changes) > 2 * np.median(np.abs(np.diff(frames[:3], axis=0)))


def touch(page, kind, *points):
    fingers = [{"x": x, "y": y, "id": n} for n, (x, y) in enumerate(points)]
    page.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})


def test_fingers_focus_look_and_zoom_on_a_phone(page):
    page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", PHONE)
    page.execute_cdp_cmd(
        "Emulation.setTouchEmulationEnabled", {"enabled": True, "maxTouchPoints": 2}
    )
    try:
        wait_for(page, f"lightField.width === 390 && {RESTS}")
        assert page.execute_script("return document.documentElement.scrollWidth") == 390
        spacing = page.execute_script("return lightField.frame.spacing")
        touch(page, "touchStart", (120, 200))
        touch(page, "touchEnd")
        wait_for(page, RESTS)
        assert shown(page, "readout") != ""
        touch(page, "touchStart", (120, 200))
        for x in (130, 150, 170):
            touch(page, "touchMove", (x, 200))
        touch(page, "touchEnd")
        assert settings(page)["q"][0] < -1
        touch(page, "touchStart", (130, 200), (230, 200))
        for far in (10, 18, 25):
            touch(page, "touchMove", (130 - far, 200), (230 + far, 200))
        touch(page, "touchEnd")
        assert page.execute_script("return lightField.frame.spacing") == pytest.approx(
            spacing * 100 / 150, rel=0.1
        )
    finally:
        page.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})
        page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", SCREEN)
    assert errors(page) == []
