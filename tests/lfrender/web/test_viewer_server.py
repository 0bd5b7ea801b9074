"""The viewer's server serves the files of the page, to this machine, and nothing else."""

from __future__ import annotations

import http.client
import threading
import time

import pytest

import lfcal
import lfrender
from lfrender.web.viewer import FlatPages
from lfrender.web.viewer_server import PageServer, ServerError


def respond(server, path, host=None, method="GET"):
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=5)
    connection.putrequest(method, path, skip_host=True)
    connection.putheader("Host", host or f"127.0.0.1:{server.server_port}")
    connection.endheaders()
    response = connection.getresponse()
    content = response.read()
    connection.close()
    return response, content


@pytest.fixture
def small_server():
    server = PageServer({"index.html": b"page", "data/a.js": b"data"})
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server
    server.shutdown()
    server.server_close()


def test_the_server_gives_its_own_files_to_this_machine_only(small_server):
    assert small_server.server_address[0] == "127.0.0.1"
    response, content = respond(small_server, "/")
    assert (response.status, content) == (200, b"page")
    assert response.getheader("Content-Security-Policy").startswith("default-src 'none'")
    assert respond(small_server, "/data/a.js")[1] == b"data"
    head, content = respond(small_server, "/index.html", method="HEAD")
    assert (head.status, content, head.getheader("Content-Length")) == (200, b"", "4")
    for path in ("/etc/passwd", "/../pyproject.toml", "//etc/passwd", "/data/", "/data/%2e%2e/index.html"):
        assert respond(small_server, path)[0].status == 404
    assert respond(small_server, "/", host="elsewhere.example")[0].status == 403
    assert respond(small_server, "/", method="POST")[0].status == 501


def test_a_port_that_is_taken_is_refused_by_name(small_server):
    with pytest.raises(ServerError, match=f"port {small_server.server_port}"):
        PageServer({"index.html": b""}, small_server.server_port)


def test_a_flat_is_loaded_when_it_is_looked_at_and_the_next_one_ahead_of_time(house):
    camera, asked = house.truth.calibration, []
    depth = lfrender.analyze(house.flat, camera, "fast")

    def load(number):
        asked.append(number)
        if number == 1:
            raise lfcal.FlatError("b.png: is damaged")
        return house.flat, camera, depth

    pages = FlatPages(["a.png", "b.png", "c.png"], load)
    assert b"<h1>b.png</h1>" in pages.get("2.html") and b'href="index.html"' in pages.get("2.html")
    assert b"2 of 3" in pages.get("2.html") and pages.get("4.html") is pages.get("data/4/scene.json.js") is None
    assert asked == []
    assert b"lightFieldData" in pages.get("data/1/scene.json.js")
    end = time.monotonic() + 10
    while asked != [0, 1]:
        assert time.monotonic() < end, asked
        time.sleep(0.01)
    assert b"b.png: is damaged" in pages.get("data/2/scene.json.js")
    assert pages.get("data/1/flat-0-0.png.js") is not None and asked.count(0) == 1
