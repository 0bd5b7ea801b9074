"""The page about security says what the code does."""

from __future__ import annotations

import ast
import http.client
import re
from pathlib import Path

import pytest
from starlette.responses import PlainTextResponse

from lfcal.images.pixels import MAX_PIXELS
from lfcal.runtime import arrays, input_file
from lfrender.data import depth_file
from lfrender.web import server as web

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
SOURCES = [
    path
    for package in ("lfcal", "lfrender", "data_synth")
    for path in (ROOT / package).rglob("*.py")
]


@pytest.mark.parametrize(
    "sentence",
    [
        f"sends nothing for {web.QUIET:g} s is closed",
        f"headers of more than {web.LARGEST_HEAD} bytes | 400",
        f"beyond {web.MOST_CONNECTIONS} connections at once | 503",
        f"a command without the header `{web.OWN_PAGE}` | 403",
        f"{MAX_PIXELS / 1e6:,.0f} megapixels in memory",
        f"{input_file.LARGEST_TEXT / 1e6:.0f} MB of text",
        f"a packed array in it {arrays.LARGEST_BLOCK / 1e6:.0f} MB",
        f"at most {depth_file.LARGEST_RATIO} times its size, or {depth_file.SMALL / 1e6:.0f} MB",
    ],
)
def test_limits_are_those_of_the_code(sentence):
    assert sentence in PAGE


def test_one_module_listens_and_none_executes_what_is_in_a_file():
    for path in SOURCES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
        assert not used & {"eval", "exec", "pickle", "marshal"}, path
    listening = re.compile(r"create_server\(|HTTPServer|\.listen\(")
    assert [
        path.name for path in SOURCES if listening.search(path.read_text(encoding="utf-8"))
    ] == ["server.py"]


def _ask(server, method, path, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=5)
    connection.request(
        method, path, headers={name.replace("_", "-"): value for name, value in headers.items()}
    )
    response = connection.getresponse()
    response.read()
    connection.close()
    return response


def test_requests_are_refused_as_the_page_says():
    with web.WebServer({("POST", "/stop"): lambda _: PlainTextResponse("")}) as server:
        own = {"X_Lfrender": "1"}
        cases = {
            "another host name": _ask(server, "GET", "/", Host="x.example"),
            "with a body": _ask(server, "POST", "/stop", Transfer_Encoding="chunked", **own),
            "an unknown path": _ask(server, "POST", "/start", **own),
            "another method": _ask(server, "DELETE", "/stop"),
            "damaged": _ask(server, "GET", "/" + "a" * 40_000),
        }
        for words, response in cases.items():
            (row,) = [line for line in PAGE.splitlines() if line.startswith("|") and words in line]
            assert f"| {response.status}" in row
        for name in re.findall(r"`((?:Content|Cross|Cache|Referrer)-[\w-]+)`", PAGE):
            assert cases["an unknown path"].getheader(name), name
