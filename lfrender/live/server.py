"""The live page over HTTP: pictures as JPEG, the status as JSON, and commands; on this machine alone, or with a token.

A page asks for the picture after the last one that it has shown, and waits until there is one: a slow browser gets
fewer pictures, and holds up nobody.
"""

from __future__ import annotations

import ipaddress
import json
import secrets
import socket
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

from lfcal import LightFieldError

from ..web.templates import fill, read_asset
from ..web.viewer_server import ServerError
from .session import KINDS, Session

__all__ = ["LiveServer"]

_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
# Browsers send this header only for the page itself: for pages of others they would ask first, and get no answer.
_OWN_PAGE = "X-Lfrender"


class LiveServer(ThreadingHTTPServer):
    """Serves the page of a session on an address of this machine; port 0 takes any that is free.

    Beyond the loopback, requests need the token that is in `url`. ServerError if address or port cannot be used.
    """

    daemon_threads = True

    def __init__(self, session: Session, title: str, host: str = "127.0.0.1", port: int = 0) -> None:
        self.session = session
        #: Nothing on the loopback.
        self.token = "" if _is_loopback(host) else secrets.token_urlsafe(16)
        self.host = host
        self.page = str(
            fill("live.html", title=title, style=read_asset("viewer.css"), script=read_asset("live.js"))
        ).encode()
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            super().__init__((host, port), _Handler)
        except OSError as error:
            raise ServerError(f"{host} port {port}: cannot be used ({error.strerror or error})") from error

    @property
    def url(self) -> str:
        """The address of the page, with its token."""
        host = socket.gethostname() if self.host in ("0.0.0.0", "::") else self.host
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.server_port}/{f'?token={self.token}' if self.token else ''}"

    def is_allowed(self, host: str, token: str) -> bool:
        """Whether a request with this header `Host` and token is answered."""
        if self.token:
            return secrets.compare_digest(token.encode(), self.token.encode())
        # Against DNS rebinding: a page of another host could let its name point to this machine.
        return host in {f"{name}:{self.server_port}" for name in (self.host, "localhost", f"[{self.host}]")}


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class _Handler(BaseHTTPRequestHandler):
    server: LiveServer
    protocol_version = "HTTP/1.1"
    timeout = 60  # of a connection that sends nothing [s]

    def do_GET(self) -> None:
        if (asked := self._asked()) is None:
            return
        path, values = asked
        if path == "/":
            self._send(200, self.server.page, "text/html; charset=utf-8")
        elif path == "/status":
            self._send_json(self.server.session.status())
        elif path == "/frame" and values.get("kind") in KINDS:
            self._send_frame(values)
        else:
            self.send_error(404)

    def do_POST(self) -> None:
        if (asked := self._asked()) is None:
            return
        if self.headers.get(_OWN_PAGE) is None or self.headers.get("Content-Length", "0") != "0":
            self.send_error(403)
            return
        try:
            self.server.session.command(asked[0][1:])
        except LightFieldError as error:
            self._send_json({"message": str(error)}, 500)
        else:
            self._send_json(self.server.session.status())

    def _asked(self) -> tuple[str, dict[str, str]] | None:
        """Path and values of a request; None, once it has been refused."""
        parts = urlsplit(self.path)
        values = {name: found[-1] for name, found in parse_qs(parts.query).items()}
        if not self.server.is_allowed(self.headers.get("Host", ""), values.get("token", "")):
            self.send_error(403)
            return None
        return parts.path, values

    def _send_frame(self, values: dict[str, str]) -> None:
        try:
            after, x, y = int(values.get("after", 0)), *(float(values.get(name, 0.5)) for name in "xy")
            if not (0 <= x <= 1 and 0 <= y <= 1):
                raise ValueError("x and y are shares of width and height")
        except ValueError:
            self.send_error(400)
            return
        try:
            found = self.server.session.picture(values["kind"], after, (x, y))
        # What is wrong with one picture, such as a place without depth, is said, and the page goes on.
        except Exception as error:
            self._send_json({"message": " ".join(str(error).split())}, 500)
            return
        if found is None:
            self._send(204, b"", "text/plain")
            return
        view, data = found
        self._send(200, data, "image/jpeg", {"X-Frame": str(view.shot.number)})

    def _send_json(self, values: dict[str, Any], status: int = 200) -> None:
        self._send(status, json.dumps(values).encode(), "application/json")

    def _send(self, status: int, content: bytes, kind: str, more: dict[str, str] | None = None) -> None:
        headers = {
            "Content-Type": kind, "Content-Length": str(len(content)), "Content-Security-Policy": _POLICY,
            "X-Content-Type-Options": "nosniff", "Cache-Control": "no-store", "Referrer-Policy": "no-referrer",
        }  # fmt: skip
        try:
            self.send_response(status)
            for name, value in (headers | (more or {})).items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(content)
        except ConnectionError:
            # The page was closed.
            self.close_connection = True

    def log_message(self, format: str, *args: object) -> None:
        """Requests are not shown on the terminal."""
