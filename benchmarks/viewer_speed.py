"""Work and time of a viewer's frame in headless Chromium: `python -m benchmarks.viewer_speed FLAT
[ARGUMENT ...]`.

Prints for each mode, with the whole flat in a picture of 1080 x 900 pixels and at 100 %, how often
the shader reads a texture for one pixel, counted by the shader itself, and the milliseconds of a
frame: median of several, each until the graphics card is done. Further arguments go to Chromium;
without any it draws in software, on the processor.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

import lfcal
import lfrender
from lfrender.web.viewer import write_viewer

_SIZE = (1080, 900)
_SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
_MODES: dict[str, dict[str, Any]] = {
    "at one depth": {"mode": "focus"},
    "from one depth to another": {"mode": "range"},
    "everywhere": {"mode": "sharp"},
    "everywhere, from aside": {"mode": "sharp", "aside": 0.5},
    "tiles": {"mode": "tiles"},
}
# Every read adds to a number that is drawn in the place of the colour.
_COUNTING = """
const shader = document.getElementById("shader").textContent.trim()
  .replace(/(precision highp sampler2DArray;)/, `$1
int reads = 0;
#define texelFetch(s, at, level) (reads++, texelFetch(s, at, level))
#define textureLod(s, at, level) (reads++, textureLod(s, at, level))`)
  .replace(/result = vec4\\(colour, 1.0\\);/,
           "result = vec4(vec2(reads & 255, reads >> 8) / 255.0, 0.0, 1.0);");
globalThis.counting = lightField.renderer.program(shader);
globalThis.drawing = lightField.renderer.main;
"""
_FRAMES = """
const [change, size, spacing] = arguments, v = lightField, { aside, ...rest } = change;
const q = [(aside ?? 0) * v.scene.radius, 0];
const settings = { ...v.settings, ...rest, q, background: [0, 0, 0] };
const first = v.scene.size.map((n, k) => (n - 1) / 2 - ((size[k] - 1) / 2) * spacing);
v.renderer.main = counting;
const counts = v.pixels(...size, first, spacing, settings);
v.renderer.main = drawing;
let reads = 0;
for (let n = 0; n < counts.length; n += 4) reads += counts[n] + 256 * counts[n + 1];
const times = [], one = new Uint8Array(4), { gl } = v.renderer;
Object.assign(v.canvas, { width: size[0], height: size[1] });
for (let n = 0; n < 4; n++) {
  const start = performance.now();
  v.renderer.draw(settings, ...size, first, spacing);
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, one);
  times.push(performance.now() - start);
}
return [reads / (size[0] * size[1]), times.slice(1)];
"""


def _browser(arguments: list[str]) -> Any:
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or shutil.which("google-chrome") or ""
    for option in (
        "--headless=new",
        "--no-sandbox",
        "--disable-dev-shm-usage",
        *(arguments or _SOFTWARE),
    ):
        options.add_argument(option)
    browser = webdriver.Chrome(
        options=options, service=webdriver.ChromeService(shutil.which("chromedriver"))
    )
    browser.set_script_timeout(300)
    return browser


def main(arguments: list[str]) -> None:
    """Write the viewer's page of a flat, open it, and print a row for each mode and zoom."""
    if not arguments:
        sys.exit(__doc__)
    flat = lfcal.read_flat(arguments[0])
    camera = lfcal.calibrate(flat)
    depth = lfrender.analyze(flat, camera)
    with tempfile.TemporaryDirectory() as folder:
        page = write_viewer(folder, flat, camera, depth)
        browser = _browser(arguments[1:])
        try:
            browser.get(page.as_uri())
            browser.execute_async_script(
                "const done = arguments[0];"
                "const look = () => window.lightField ? done() : setTimeout(look, 50); look()"
            )
            browser.execute_async_script(
                "lightField.renderer.loadPlain(() => {}).then(arguments[0])"
            )
            browser.execute_script(_COUNTING)
            _print_rows(browser, Path(arguments[0]).name)
        finally:
            browser.quit()


def _print_rows(browser: Any, name: str) -> None:
    renderer = browser.execute_script(
        "const { gl } = lightField.renderer, e = gl.getExtension('WEBGL_debug_renderer_info');"
        "return gl.getParameter(e ? e.UNMASKED_RENDERER_WEBGL : gl.RENDERER)"
    )
    whole, full = browser.execute_script(
        "const { size, pitch, scale } = lightField.scene;"
        "return [Math.max(size[0] / arguments[0], size[1] / arguments[1]), pitch / scale]",
        *_SIZE,
    )
    print(f"{name}, {_SIZE[0]} x {_SIZE[1]} px, {renderer}")
    print(f"{'':26}{'zoom':>10}{'reads/pixel':>14}{'ms':>10}")
    for words, change in _MODES.items():
        for zoom, spacing in (("fit", whole), ("100 %", full)):
            reads, times = browser.execute_script(_FRAMES, change, _SIZE, spacing)
            print(f"{words:26}{zoom:>10}{reads:14.1f}{median(times):10.1f}")


if __name__ == "__main__":
    main(sys.argv[1:])
