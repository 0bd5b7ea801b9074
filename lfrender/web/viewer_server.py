"""An HTTP server for the viewer's page, reachable from this machine alone, with no other files."""

from __future__ import annotations

import sys
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from lfcal import LightFieldError

__all__ = ["PageServer", "ServerError"]

_HOST = "127.0.0.1"
# Nothing is loaded from other hosts: scripts are inline, in data URLs, or among the files.
_POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' data:; style-src 'unsafe-inline'; "
    "img-src 'self' data: blob:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)


class ServerError(LightFieldError, OSError):
    """The page cannot be served."""


class PageServer(ThreadingHTTPServer):
    """Serves what `files.get` gives for paths relative to the root, over HTTP to programs on this machine.

    Port 0 takes any that is free; ServerError if the port is taken or not allowed.
    """

    daemon_threads = True

    def __init__(self, files: Any, port: int = 0) -> None:
        self.files = files
        try:
            super().__init__((_HOST, port), _Handler)
        except OSError as error:
            raise ServerError(f"port {port}: cannot be used ({error.strerror}); leave out --port") from error

    @property
    def url(self) -> str:
        return f"http://{_HOST}:{self.server_port}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Browsers that no longer wait for an answer are no error."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    server: PageServer
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        # Protects against DNS rebinding: a page of another host could let its name point to this machine.
        port = self.server.server_port
        known = self.headers.get("Host") in (f"{_HOST}:{port}", f"localhost:{port}")
        path = self.path.partition("?")[0]
        content = self.server.files.get(path[1:] or "index.html") if known else None
        if content is None:
            self.send_error(404 if known else 403)
            return
        self.send_response(200)
        kind = "javascript" if path.endswith(".js") else "html"
        self.send_header("Content-Type", f"text/{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Content-Security-Policy", _POLICY)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(content)

    do_HEAD = do_GET

    def log_message(self, format: str, *args: object) -> None:
        """Requests are not shown on the terminal."""
