"""The server of the pages answers this machine alone, refuses what no page sends, and gives up
quiet connections.
"""

from __future__ import annotations

import http.client
import signal
import socket
import threading
import time

import pytest
from starlette.responses import PlainTextResponse

import lfcal
import lfrender
from lfrender.web import server as web
from lfrender.web.server import ServerError, WebServer, page_routes
from lfrender.web.viewer import FlatPages


def respond(server, path, host=None, method="GET", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=5)
    connection.putrequest(method, path, skip_host=True)
    connection.putheader("Host", host or f"127.0.0.1:{server.port}")
    for name, value in headers.items():
        connection.putheader(name.replace("_", "-"), value)
    connection.endheaders()
    response = connection.getresponse()
    content = response.read()
    connection.close()
    return response, content


@pytest.fixture
def small_server():
    def fail(_):
        raise RuntimeError("a defect\nof two lines")

    routes = {("POST", "/record"): lambda _: PlainTextResponse("done"), ("GET", "/fail"): fail}
    with WebServer(
        {**routes, **page_routes({"index.html": b"page", "data/a.js": b"data"})}
    ) as server:
        yield server


def test_the_server_gives_its_own_files_to_this_machine_only(small_server):
    response, content = respond(small_server, "/")
    assert (response.status, content) == (200, b"page")
    assert response.getheader("Content-Security-Policy").startswith("default-src 'none'")
    assert response.getheader("Server") is None
    assert respond(small_server, "/data/a.js")[1] == b"data"
    head, content = respond(small_server, "/index.html", method="HEAD")
    assert (head.status, content, head.getheader("Content-Length")) == (200, b"", "4")
    for path in (
        "/etc/passwd",
        "/../pyproject.toml",
        "//etc/passwd",
        "/data/",
        "/data/%2e%2e/index.html",
    ):
        assert respond(small_server, path)[0].status == 404
    assert respond(small_server, "/", host="elsewhere.example")[0].status == 403
    assert respond(small_server, "/", method="POST", X_Lfrender="1")[0].status == 405


def test_pages_of_other_sites_bodies_and_unknown_commands_are_refused(small_server):
    own = {"X_Lfrender": "1", "Origin": f"http://127.0.0.1:{small_server.port}"}
    assert respond(small_server, "/record", method="POST", **own)[0].status == 200
    refused = {
        403: [{}, {**own, "Origin": "http://elsewhere.example"}, {**own, "Origin": "null"}],
        413: [{**own, "Content_Length": "5"}, {**own, "Transfer_Encoding": "chunked"}],
    }
    for status, cases in refused.items():
        for headers in cases:
            assert respond(small_server, "/record", method="POST", **headers)[0].status == status
    assert respond(small_server, "/delete", method="POST", **own)[0].status == 405
    assert respond(small_server, "/", Origin="http://elsewhere.example")[0].status == 403


def test_damaged_requests_resets_and_defects_print_nothing(small_server, capfd):
    for request in (
        b"GET http://[::1/ HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"\x00\xff\r\n\r\n",
        b"GET / HTTP/1.1\r\nX: " + b"a" * 40_000 + b"\r\n\r\n",
    ):
        with socket.create_connection(("127.0.0.1", small_server.port), timeout=5) as connection:
            connection.sendall(request)
            assert connection.recv(100)[:12] in (b"HTTP/1.1 400", b"HTTP/1.1 403")
    with socket.create_connection(("127.0.0.1", small_server.port)) as connection:
        connection.setsockopt(
            socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0"
        )  # a reset when closed
        connection.sendall(b"GET /index.html HTTP/1.1\r\n")
    response, content = respond(small_server, "/fail")
    assert (response.status, content) == (500, b"a defect of two lines")
    assert respond(small_server, "/")[0].status == 200
    assert capfd.readouterr() == ("", "")


def test_half_open_connections_hold_no_threads_and_are_closed(monkeypatch):
    monkeypatch.setattr(web, "QUIET", 1.0)
    with WebServer(page_routes({"index.html": b"page"})) as server:
        before = threading.active_count()
        held = [
            socket.create_connection(("127.0.0.1", server.port), timeout=20) for _ in range(150)
        ]
        for connection in held:
            connection.sendall(b"GET / HTTP/1.1\r\nHost:")
        assert respond(server, "/")[0].status == 200
        assert threading.active_count() <= before + 2
        # The end of the stream: the server has closed it.
        assert {connection.recv(1) for connection in held} == {b""}
        for connection in held:
            connection.close()


def test_an_answer_that_takes_longer_than_a_quiet_connection_may_is_given(monkeypatch):
    monkeypatch.setattr(web, "QUIET", 0.2)

    def slow(_):
        time.sleep(1)
        return PlainTextResponse("done")

    with WebServer({("GET", "/"): slow}) as server:
        assert respond(server, "/")[1] == b"done"
        start = time.monotonic()
        with socket.create_connection(("127.0.0.1", server.port)) as connection:
            connection.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n".encode())
            time.sleep(0.2)
            server.close()
        assert time.monotonic() - start < 3


def test_a_request_that_waits_when_ctrl_c_ends_the_server_is_told_so():
    waiting, go_on = threading.Event(), threading.Event()

    def wait(_):
        waiting.set()
        go_on.wait(10)
        return PlainTextResponse("late")

    found = []
    with WebServer({("GET", "/slow"): wait}) as server:
        asks = threading.Thread(target=lambda: found.append(respond(server, "/slow")))
        asks.start()
        assert waiting.wait(5)
        threading.Timer(0.2, lambda: signal.raise_signal(signal.SIGINT)).start()
        with pytest.raises(KeyboardInterrupt):
            server.wait()
    go_on.set()
    asks.join(5)
    ((response, content),) = found
    assert (response.status, content) == (503, b"the page is closed")


def test_a_port_that_is_taken_is_refused_by_name(small_server):
    with pytest.raises(ServerError, match=f"port {small_server.port}"):
        WebServer(page_routes({"index.html": b""}), port=small_server.port)


def test_a_flat_is_loaded_when_it_is_looked_at_and_the_next_one_ahead_of_time(house):
    camera = house.truth.calibration
    asked = []
    depth = lfrender.analyze(house.flat, camera, "fast")

    def load(number):
        asked.append(number)
        if number == 1:
            raise lfcal.FlatError("b.png: is damaged")
        return house.flat, camera, depth

    pages = FlatPages(["a.png", "b.png", "c.png"], load)
    assert b"<h1>b.png</h1>" in pages.get("2.html") and b'href="index.html"' in pages.get("2.html")
    assert (
        b"2 of 3" in pages.get("2.html")
        and pages.get("4.html") is pages.get("data/4/scene.json.js") is None
    )
    assert asked == []
    assert b"lightFieldData" in pages.get("data/1/scene.json.js")
    end = time.monotonic() + 10
    while asked != [0, 1]:
        assert time.monotonic() < end, asked
        time.sleep(0.01)
    assert b"b.png: is damaged" in pages.get("data/2/scene.json.js")
    assert pages.get("data/1/flat-0-0.png.js") is not None and asked.count(0) == 1
