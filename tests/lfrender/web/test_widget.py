"""The widget of notebooks: the page of the viewer, with its settings as traits, in a browser."""

from __future__ import annotations

import base64
import functools
import http.server
import json
import threading
from pathlib import Path

import pytest

import lfrender
from lfrender.web.viewer import viewer_page

from ._browser import errors, start_browser, wait_for

MODULE = Path(lfrender.__file__).parent / "web" / "assets" / "widget.js"
# What a notebook gives to a widget: a model with traits, and an element.
NOTEBOOK = """<!doctype html><div id="cell"></div><script type="module">
import widget from "data:text/javascript;base64,%s";
const values = %s, waiting = {};
globalThis.model = {
  values, saved: 0,
  get: name => values[name],
  set: (name, value) => { values[name] = value; },
  change: (name, value) => { values[name] = value; waiting[`change:${name}`]?.(); },
  on: (name, call) => { waiting[name] = call; },
  save_changes: () => { model.saved += 1; },
};
widget.render({ model, el: document.getElementById("cell") });
</script>"""


@pytest.fixture(scope="module")
def captured(house):
    camera = house.truth.calibration
    return house.flat, camera, lfrender.analyze(house.flat, camera, "fast")


@pytest.fixture(scope="module")
def browser():
    driver = start_browser()
    yield driver
    driver.quit()


def test_widget_has_the_page_and_its_settings(captured):
    anywidget = pytest.importorskip("anywidget", reason="the widget needs lfrender[notebook]")
    from lfrender.web.widget import light_field_widget

    widget = light_field_widget(*captured, title="House", height=300)
    assert isinstance(widget, anywidget.AnyWidget)
    assert (
        widget.height == 300
        and "lightFieldFiles" in widget.page
        and "<h1>House</h1>" in widget.page
    )
    widget.viewpoint = [2.0, -1.0]
    with pytest.raises(Exception, match="mode"):
        widget.mode = "other"


def test_page_and_model_keep_each_other_equal(browser, captured, tmp_path):
    values = {
        "page": viewer_page(*captured),
        "height": 300,
        "mode": "focus",
        "plane": None,
        "aperture": 1.0,
        "overlay": 0.0,
        "viewpoint": [0.0, 0.0],
    }
    module = base64.b64encode(MODULE.read_bytes()).decode()
    text = json.dumps(values).replace("</", "<\\/")
    (tmp_path / "index.html").write_text(NOTEBOOK % (module, text), encoding="utf-8")
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(tmp_path))
    handler.log_message = lambda *_: None
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        browser.get(f"http://127.0.0.1:{server.server_port}/index.html")
        inner = "document.querySelector('iframe').contentWindow.lightField"
        wait_for(browser, f"document.querySelector('iframe') && {inner} && {inner}.ready")
        browser.execute_script("model.change('plane', -6.0); model.change('viewpoint', [3.0, 0.0])")
        wait_for(browser, f"{inner}.settings.plane === -6.0 && {inner}.settings.q[0] === 3.0")
        before = browser.execute_script("return model.saved")
        browser.execute_script(f"{inner}.set({{ mode: 'sharp', q: [0, 2] }})")
        wait_for(browser, f"model.saved > {before} && model.values.mode === 'sharp'")
        assert browser.execute_script("return model.values.viewpoint") == [0, 2]
        shown = browser.execute_script(
            f"return Array.from({inner}.pixels(40, 30, [100, 100], 4)).slice(0, 4000)"
        )
        assert len(set(shown)) > 20, "the picture is not blank"
        assert [e for e in errors(browser) if "favicon" not in e] == []
        server.shutdown()
