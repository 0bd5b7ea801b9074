"""The viewer draws what the renderer draws, and does what mouse and keys ask for."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import urllib.request
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.ndimage import maximum_filter, minimum_filter

import lfcal
import lfrender
from lfcal.lattice.distortion import Distortion
from lfcal.runtime.light.tone import apply_tone
from lfrender.cli.main import main
from lfrender.data.depth_map import DepthMap, default_scale
from lfrender.data.surface import Surface
from lfrender.flat.prefilter import prefilter_flat
from lfrender.output.finish import Finish, flat_picture
from lfrender.rendering.viewpoints import views_with_depth
from lfrender.web.viewer import viewer_page, write_viewer
from lfrender.web.viewer_scene import viewer_scene

from ._browser import READY, RESTS, errors, mouse, pixels, wait_for

# Patch sizes of the house and of the branches in front of it [px].
FAR = 6.09
NEAR = -6.0


def off(browser, picture, **settings):
    """Difference [grey levels] of the viewer's picture from one of the renderer's, where that shows
    something.
    """
    found = pixels(browser, picture.image.shape[:2], picture.affine, **settings).astype(int)
    return np.abs(found - picture.image)[picture.valid].max(-1)


def at_depth_edges(picture, sizes, depth):
    """Pixels within a pitch of an edge of the patch sizes that the picture shows."""
    window = 2 * int(np.ceil(picture.scale)) + 1
    return maximum_filter(sizes, window) - minimum_filter(sizes, window) > 0.05 * depth.pitch


@pytest.mark.parametrize("aperture", [1.0, 0.4])
@pytest.mark.parametrize(("plane", "scale"), [(FAR, None), (FAR, 4.0), (NEAR, None)])
def test_a_plane_in_focus_is_that_of_the_renderer(page, captured, plane, aperture, scale):
    flat, camera, depth = captured
    # The viewer draws the light field alone: without a depth map, so does the renderer.
    scale = scale or default_scale(depth)
    picture = lfrender.refocus(flat, camera, plane, aperture=aperture, scale=scale)
    difference = off(page, picture, mode="focus", plane=plane, aperture=aperture)
    # At the rim of the aperture rounding decides whether a lens takes part at all.
    assert np.mean(difference <= 2) > 0.9995
    assert difference.mean() < 0.01


def test_everything_in_focus_and_tiles_are_those_of_the_renderer(page, captured):
    flat, camera, depth = captured
    # At a scale of 4 or 4.1, some samples lie halfway between the values of the surface, where
    # rounding decides on which side of a depth edge they are.
    for scale in (None, 4.17):
        picture = lfrender.render(flat, camera, depth, scale=scale, detail="off")
        difference = off(page, picture, mode="sharp")
        assert np.mean(difference <= 2) > 0.9995
        assert difference.max() <= 5
    page.execute_script("lightField.set({ mode: 'tiles' })")
    wait_for(page, "lightField.renderer.textures.plainTiles")
    crisp = lfrender.render(flat, camera, patch_size=FAR)
    assert np.mean(off(page, crisp, mode="tiles", plane=FAR) <= 2) > 0.9995
    # Not the flat that blended pictures read.
    sharpened = lfrender.render(prefilter_flat(flat), camera, patch_size=FAR)
    assert np.mean(off(page, sharpened, mode="tiles", plane=FAR) <= 2) < 0.9


def test_brightness_is_a_factor_on_light(page, captured):
    flat, camera, depth = captured
    picture = lfrender.render(flat, camera, depth, detail="off")
    for stops in (1.0, -2.0):
        brighter = apply_tone(picture.image, np.uint8, True, gain=2.0**stops)
        difference = off(page, replace(picture, image=brighter), mode="sharp", brightness=stops)
        assert np.mean(difference <= 3) > 0.999


def test_a_view_from_aside_is_that_of_the_renderer(page, captured):
    flat, camera, depth = captured
    q = (0.5 * camera.lattice.radius, -0.3 * camera.lattice.radius)
    picture, sizes = next(views_with_depth(flat, camera, depth, offsets=[q], still=FAR))
    same = off(page, picture, mode="sharp", plane=FAR, q=list(q)) <= 2
    # Steps of the ray to the surface and what lenses see at depth edges differ in a few pixels.
    edges = at_depth_edges(picture, sizes, depth)[picture.valid]
    assert same[~edges].mean() > 0.999
    assert same[edges].mean() > 0.995


def test_a_flat_with_distortion_lens_types_and_sixteen_bits_is_drawn_as_the_renderer_draws_it(
    browser, house, tmp_path
):
    width, height = house.flat.shape[1::-1]
    bend = Distortion(np.array([250.0, 190.0]), 0.02, 0.0, float(np.hypot(width, height)) / 2)
    camera = house.truth.calibration
    types = lfcal.LensTypes([[0, 2, 1], [1, 0, 2], [2, 1, 0]], True, np.array([0.5, 0.3, 0.15]))
    camera = replace(camera, lattice=replace(camera.lattice, distortion=bend), lens_types=types)
    flat = (house.flat.astype(np.uint16) * 257).astype(np.uint16)
    depth = two_planes(camera)
    write_viewer(tmp_path, flat, camera, depth)
    # From a disk, where browsers refuse to fetch files.
    browser.get((tmp_path / "index.html").as_uri())
    wait_for(browser, READY)
    # The page gets the flat with 8 bits, as it is shown: brightened, by the curve of sRGB.
    shown = Finish("flat.webp").apply(flat_picture(flat, camera)).image
    for picture, settings in (
        (lfrender.refocus(shown, camera, FAR), {"mode": "focus", "plane": FAR}),
        (lfrender.render(shown, camera, depth, detail="off"), {"mode": "sharp"}),
    ):
        assert np.mean(off(browser, picture, **settings) <= 2) > 0.9995
    assert errors(browser) == []


def two_planes(camera):
    """A depth map with its edge in the middle."""
    lattice = camera.lattice
    size = np.where(lattice.centres()[:, 0] < lattice.image_size[0] / 2, FAR, NEAR).astype(
        np.float32
    )
    spacing = lattice.pitch / 7
    columns, rows = (int(np.ceil(n / spacing)) + 1 for n in lattice.image_size)
    surface = np.full((rows, columns), FAR, np.float32)
    surface[:, columns // 2 :] = NEAR
    one = np.ones(len(size), np.float32)
    return DepthMap(
        size,
        one,
        one,
        size,
        Surface(surface, (-0.5, -0.5), spacing),
        lattice.pitch,
        lattice.image_size,
    )


def place_of(page, wanted, depth, lattice):
    """Scene point and canvas position of a place far from depth edges with a patch size near
    `wanted`.
    """
    surface = depth.surface
    alike = (np.abs(surface.patch_size - wanted) < 1.2).astype(np.uint8)
    alike = cv2.copyMakeBorder(alike[12:-12, 12:-12], 12, 12, 12, 12, cv2.BORDER_CONSTANT, value=0)
    inside = cv2.distanceTransform(alike, cv2.DIST_L2, 3)
    v, u = np.unravel_index(np.argmax(inside), inside.shape)
    x, y = np.array([u, v]) * surface.spacing + surface.first
    on_page = page.execute_script(
        "const v = lightField, [x, y] = arguments, f = v.frame.first(v.width, v.height);"
        "const step = v.frame.spacing * devicePixelRatio;"
        "return [(x - f[0]) / step, (y - f[1]) / step]",
        x,
        y,
    )
    return (float(x), float(y)), on_page


def around(page, place, side, spacing, **settings):
    """The picture about a scene point."""
    first = np.array(place) - spacing * (side - 1) / 2
    return pixels(page, (side, side), np.column_stack([np.eye(2) * spacing, first]), **settings)


def blur(page, place):
    """RMS difference [grey levels] about a scene point from the picture sharp everywhere."""
    sharp, now = (
        around(page, place, 14, 2.0, **settings).astype(float)
        for settings in ({"mode": "sharp"}, {})
    )
    return np.sqrt(np.mean((now - sharp) ** 2))


@pytest.mark.parametrize(("wanted", "other"), [(FAR, NEAR), (NEAR, FAR)])
def test_a_click_focuses_there(page, captured, wanted, other):
    _, camera, depth = captured
    place, on_page = place_of(page, wanted, depth, camera.lattice)
    page.execute_script("lightField.set({ plane: arguments[0] })", other)
    before = blur(page, place)
    piece = around(page, place, 14, 2.0)
    mouse(page, on_page)
    wait_for(page, RESTS)
    plane = page.execute_script("return lightField.settings.plane")
    assert plane == pytest.approx(float(depth.surface.at(np.array([place]))[0]), abs=0.3)
    assert blur(page, place) < 0.5 * before
    assert ("telescopic" if wanted > 0 else "binocular") in page.find_element(
        "id", "plane-value"
    ).text
    if wanted == FAR:
        # The branches have no texture of their own that could become sharper.
        detail = [
            cv2.Laplacian(p.astype(np.float32), cv2.CV_32F).std()
            for p in (piece, around(page, place, 14, 2.0))
        ]
        assert detail[1] > 1.3 * detail[0]


def test_dragging_moves_near_and_far_apart(page, captured):
    _, camera, depth = captured
    page.execute_script("lightField.set({ mode: 'sharp', plane: arguments[0] })", FAR)
    wait_for(page, RESTS)
    start = (200, 200)
    mouse(page, start, (160, 200), (150, 200))
    q = page.execute_script("return lightField.settings.q")
    assert q[0] > 0.3 * camera.lattice.radius
    assert abs(q[1]) < 1e-6
    spacing = 2.0
    for wanted in (FAR, NEAR):
        place, _ = place_of(page, wanted, depth, camera.lattice)
        s = float(depth.surface.at(np.array([place]))[0])
        moved = q[0] * (camera.lattice.pitch / s - camera.lattice.pitch / FAR)
        piece = around(page, place, 20, spacing, q=[0, 0])
        wider = around(page, place, 20 + 2 * 30, spacing)
        score = cv2.matchTemplate(wider, piece, cv2.TM_CCOEFF_NORMED)
        y, x = np.unravel_index(np.argmax(score), score.shape)
        # Places with s = FAR stay, those in front of them move against q.
        assert (x - 30) * spacing == pytest.approx(moved, abs=2 * spacing)
        assert (y - 30) * spacing == pytest.approx(0, abs=2 * spacing)


def test_keys_do_what_the_mouse_does(page):
    from selenium.webdriver.common.keys import Keys

    canvas = page.find_element("id", "picture")
    before = page.execute_script(
        "return [lightField.settings.plane, lightField.frame.spacing, lightField.frame.middle]"
    )
    canvas.send_keys(
        Keys.ARROW_RIGHT, "a", "m", ",", "+", Keys.SHIFT + Keys.ARROW_LEFT + Keys.NULL, Keys.PAGE_UP
    )
    state = page.execute_script(
        "const { settings: s, frame: f } = lightField; return [s, f.spacing, f.middle]"
    )
    settings, spacing, middle = state
    assert settings["q"][0] > 0
    assert settings["mode"] == "sharp"
    assert settings["overlay"] > 0
    assert settings["aperture"] == pytest.approx(0.95)
    assert settings["plane"] != before[0]
    assert spacing == pytest.approx(before[1] / 1.25)
    assert middle[0] < before[2][0]
    assert page.find_element("id", "legend").is_displayed()
    canvas.send_keys("a", "m", "c", "0")
    settings, spacing, middle = page.execute_script(
        "const { settings: s, frame: f } = lightField; return [s, f.spacing, f.middle]"
    )
    assert (settings["mode"], settings["overlay"], settings["q"]) == ("focus", 0, [0, 0])
    assert [spacing, middle] == before[1:]


def test_the_canvas_shows_the_picture_and_every_control_has_a_name(page):
    page.execute_script("lightField.set({ mode: 'sharp' })")
    wait_for(page, RESTS)
    page.execute_script("lightField.draw()")
    shot = cv2.imdecode(
        np.frombuffer(page.find_element("id", "picture").screenshot_as_png, np.uint8),
        cv2.IMREAD_COLOR,
    )
    assert shot.std() > 25
    nameless = page.execute_script(
        "return [...document.querySelectorAll('button, input, canvas')].filter(e => "
        "!(e.ariaLabel || e.textContent.trim() || (e.labels && e.labels.length)))"
        ".map(e => e.outerHTML)"
    )
    assert nameless == []


def test_wheel_zooms_about_the_pointer(page):
    at = page.execute_script(
        "return lightField.frame.at(300, 200, lightField.width, lightField.height)"
    )
    spacing = page.execute_script("return lightField.frame.spacing")
    page.execute_script(
        "const c = document.getElementById('picture'), r = c.getBoundingClientRect();"
        "c.dispatchEvent(new WheelEvent('wheel', "
        "{ deltaY: -250, clientX: r.x + 300, clientY: r.y + 200, cancelable: true }))"
    )
    assert page.execute_script("return lightField.frame.spacing") == pytest.approx(
        spacing * np.exp(-0.5), rel=1e-3
    )
    after = page.execute_script(
        "return lightField.frame.at(300, 200, lightField.width, lightField.height)"
    )
    assert after == pytest.approx(at, abs=0.5)


def test_a_depth_map_of_another_flat_is_refused(captured):
    flat, camera, depth = captured
    other = replace(depth, image_size=(100, 100))
    with pytest.raises(lfcal.CalibrationError, match="another camera"):
        viewer_page(flat, camera, other)


def test_a_flat_of_more_tiles_than_browsers_take_is_refused(captured):
    with pytest.raises(lfcal.LightFieldError, match="browsers take 256"):
        list(viewer_scene(*captured, "house", tile=20))


def test_view_serves_until_it_is_interrupted(house_files, captured, tmp_path):
    captured[2].save(tmp_path / "depth.npz")
    command = [
        sys.executable,
        "-m",
        "lfrender.cli.main",
        "view",
        str(house_files / "flat.png"),
        "--no-browser",
        "--json",
    ]
    command += ["-c", str(house_files / "camera.json"), "--depth", str(tmp_path / "depth.npz")]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(lfrender.__file__).parents[1],
        # Where the tests run in the background, interruptions are ignored, by their children too.
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
    ) as process:
        try:
            url = json.loads(process.stdout.readline())["page"]
            assert url.startswith("http://127.0.0.1:")
            with urllib.request.urlopen(url, timeout=10) as page:
                assert b"<title>flat.png" in page.read()
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=60) == 0
        finally:
            process.kill()


def test_view_exports_from_the_command_line(house_files, captured, tmp_path):
    captured[2].save(tmp_path / "depth.npz")
    arguments = ["view", str(house_files / "flat.png"), "-c", str(house_files / "camera.json")]
    arguments += ["--depth", str(tmp_path / "depth.npz"), "--export", str(tmp_path / "page")]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output
    page = (tmp_path / "page" / "index.html").read_text(encoding="utf-8")
    assert "<title>flat.png" in page
    # Nothing from elsewhere.
    assert 'src="http' not in page
    assert 'href="http' not in page
    assert (tmp_path / "page" / "data" / "1" / "scene.json.js").exists()


def test_view_of_a_folder_exports_pages_that_lead_to_each_other(house_files, tmp_path):
    (tmp_path / "flats").mkdir()
    for name in ("f10.png", "f2.png"):
        (tmp_path / "flats" / name).write_bytes((house_files / "flat.png").read_bytes())
    (tmp_path / "flats" / "f3.png").write_text("no picture")
    words = [
        "view",
        tmp_path / "flats",
        "-c",
        house_files / "camera.json",
        "--preset",
        "fast",
        "--export",
    ]
    done = CliRunner().invoke(main, [str(word) for word in [*words, tmp_path / "page"]])
    assert done.exit_code == 0 and "f3.png: is no image" in done.stderr, done.output
    pages = [
        (tmp_path / "page" / name).read_text(encoding="utf-8")
        for name in ("index.html", "2.html", "3.html")
    ]
    assert all(
        f"<h1>{name}</h1>" in page
        for name, page in zip(("f2.png", "f3.png", "f10.png"), pages, strict=True)
    )
    assert "f3.png: is no image" in (tmp_path / "page" / "data" / "2" / "scene.json.js").read_text()
    assert (tmp_path / "page" / "data" / "3" / "flat-0-0.png.js").exists()
    for refused in (["--depth", house_files / "flat.png"], []):
        words[-1:] = [*refused, "--export"]
        done = CliRunner().invoke(main, [str(word) for word in [*words, tmp_path / "page.html"]])
        assert done.exit_code == 2 and not (tmp_path / "page.html").exists()
