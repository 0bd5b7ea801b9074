"""The HTTP server of the viewer and of the live page: for this machine, or with a token for others.

Starlette and Uvicorn. What is refused, and the limits, stand in docs/security.md.
"""

from __future__ import annotations

import asyncio
import ipaddress
import secrets
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from http.client import (
    BAD_REQUEST,
    FORBIDDEN,
    INTERNAL_SERVER_ERROR,
    NOT_FOUND,
    REQUEST_ENTITY_TOO_LARGE,
    SERVICE_UNAVAILABLE,
)
from itertools import chain
from threading import Event, Thread
from typing import Any

from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route
from uvicorn import Config, Server
from uvicorn.protocols.http.h11_impl import H11Protocol

from lfcal import LightFieldError

from ..runtime.messages import one_line

__all__ = ["LARGEST_HEAD", "MOST_CONNECTIONS", "QUIET", "ServerError", "WebServer", "page_routes"]

#: A connection that sends nothing for so long [s], while no answer is being made for it, is closed.
QUIET = 30.0
#: Of the first line and the headers of a request [bytes].
LARGEST_HEAD = 1 << 14
MOST_CONNECTIONS = 500
#: Header that the page sends with its commands. Browsers do not let pages of other sites send it.
OWN_PAGE = "X-Lfrender"
_HEADERS = {
    # Nothing is loaded from other hosts: scripts are inline, in data URLs, or among the files.
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self' 'unsafe-inline' data:; style-src 'unsafe-inline'; "
        "img-src 'self' data: blob:; connect-src 'self'; frame-ancestors 'none'; base-uri "
        "'none'; form-action 'none'"
    ),
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
}
#: Makes the answer to a request, in a thread of its own.
Answer = Callable[[Request], Response]


class ServerError(LightFieldError, OSError):
    """The page cannot be served."""


def page_routes(files: Any) -> dict[tuple[str, str], Answer]:
    """Routes of the files that `files.get` gives for paths below the root; it may take long."""

    def answer(request: Request) -> Response:
        path = request.path_params["path"] or "index.html"
        content = files.get(path)
        if content is None:
            return PlainTextResponse("not found", NOT_FOUND)
        kind = "html"
        if path.endswith(".js"):
            kind = "javascript"
        return Response(content, media_type=f"text/{kind}")

    return {("GET", "/{path:path}"): answer}


class WebServer:
    """Answers requests from a thread of its own, until it is closed.

    `routes` are answers by method and path. Port 0 takes any that is free. Beyond the loopback,
    requests need the token that is in `url`. ServerError if address or port cannot be used.
    """

    def __init__(
        self, routes: Mapping[tuple[str, str], Answer], host: str = "127.0.0.1", port: int = 0
    ) -> None:
        self.host = host
        #: Nothing on the loopback.
        self.token = "" if _is_loopback(host) else secrets.token_urlsafe(16)
        family = socket.AF_INET
        if ":" in host:
            family = socket.AF_INET6
        try:
            self._listening = socket.create_server((host, port), family=family)
        except OSError as error:
            raise ServerError(
                f"{host} port {port}: cannot be used ({error.strerror or error})"
            ) from error
        self.port: int = self._listening.getsockname()[1]
        app = Starlette(routes=[_route(*key, answer) for key, answer in routes.items()])
        self._server = Server(
            Config(
                _Guard(app, self),
                http=_Protocol,
                ws="none",
                lifespan="off",
                log_config=None,
                log_level="critical",
                access_log=False,
                server_header=False,
                proxy_headers=False,
                limit_concurrency=MOST_CONNECTIONS,
                h11_max_incomplete_event_size=LARGEST_HEAD,
                timeout_graceful_shutdown=0,
            )
        )
        # Not the end of the thread: Python takes a thread whose `join` was interrupted for ended.
        self._ended = Event()
        Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        try:
            self._server.run([self._listening])
        finally:
            self._ended.set()

    def __enter__(self) -> WebServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Answer no longer; connections are closed."""
        self._server.should_exit = True
        self._ended.wait(5)
        # Not every version of Uvicorn does so.
        self._listening.close()

    def wait(self) -> None:
        """Wait until the server is closed, or for Ctrl-C."""
        while not self._ended.wait(0.5):
            pass

    @property
    def url(self) -> str:
        """An address of the page that works, with its token."""
        host = self.host
        if host in ("0.0.0.0", "::"):
            host = _own_address(host)
        if ":" in host:
            host = f"[{host}]"
        address = f"http://{host}:{self.port}/"
        if self.token:
            return f"{address}?token={self.token}"
        return address

    def reason_to_refuse(
        self, method: str, headers: Headers, query: Mapping[str, str]
    ) -> tuple[int, str] | None:
        """Status and text for a request that is not answered."""
        host = headers.get("host", "")
        if self.token and not secrets.compare_digest(
            query.get("token", "").encode(), self.token.encode()
        ):
            return (
                FORBIDDEN,
                "open the address with its token, as 'lfrender live' prints it",
            )
        # Against DNS rebinding: a page of another host could let its name point to this machine.
        if not self.token and host not in {
            f"{name}:{self.port}" for name in (self.host, "localhost", f"[{self.host}]")
        }:
            return (
                FORBIDDEN,
                "only requests to this machine by its own name are answered",
            )
        if headers.get("origin", f"http://{host}") != f"http://{host}":
            return FORBIDDEN, "pages of other sites are not answered"
        if headers.get("content-length", "0") != "0" or "transfer-encoding" in headers:
            return REQUEST_ENTITY_TOO_LARGE, "requests have no body"
        if method == "POST" and OWN_PAGE not in headers:
            return FORBIDDEN, f"commands have the header {OWN_PAGE}"
        return None


class _Guard:
    """Refuses requests before the application gets them, and adds headers to answers (ASGI)."""

    def __init__(self, app: Any, server: WebServer) -> None:
        self._app, self._server = app, server

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        async def send_with_headers(message: Any) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(_HEADERS)
            await send(message)

        request = Request(scope)
        refused = self._server.reason_to_refuse(
            request.method, request.headers, request.query_params
        )
        # Uvicorn limits requests that arrive in parts.
        if len(str(request.url)) + sum(map(len, chain(*scope["headers"]))) > LARGEST_HEAD:
            refused = BAD_REQUEST, "the request is too long"
        app = self._app
        if refused is not None:
            status, text = refused
            # Whatever else was sent is not read.
            app = PlainTextResponse(text, status, {"Connection": "close"})
        await app(scope, receive, send_with_headers)


class _Protocol(H11Protocol):
    """HTTP/1.1 that closes quiet connections, in the middle of a request too."""

    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._wait()

    def data_received(self, data: bytes) -> None:
        self._wait()
        super().data_received(data)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)

    def _wait(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self.loop.call_later(QUIET, self._close_quiet)

    def _close_quiet(self) -> None:
        if self.cycle is not None and not self.cycle.response_complete:
            self._wait()
        else:
            self.transport.close()


def _route(method: str, path: str, answer: Answer) -> Route:
    async def endpoint(request: Request) -> Response:
        return await _in_thread(answer, request)

    return Route(path, endpoint, methods=[method])


async def _in_thread(answer: Answer, request: Request) -> Response:
    """The answer, made in a thread that does not keep the process from ending."""
    loop = asyncio.get_running_loop()
    done: asyncio.Future[Response] = loop.create_future()

    def finish(response: Response) -> None:
        if not done.done():
            done.set_result(response)

    def run() -> None:
        try:
            response = answer(request)
        # The page shows the error, and the server goes on.
        except Exception as error:
            response = PlainTextResponse(one_line(error), INTERNAL_SERVER_ERROR)
        with suppress(RuntimeError):  # the server was closed
            loop.call_soon_threadsafe(finish, response)

    Thread(target=run, daemon=True).start()
    try:
        return await done
    except asyncio.CancelledError:
        return PlainTextResponse("the page is closed", SERVICE_UNAVAILABLE)


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _own_address(host: str) -> str:
    """The address of this machine in its network, or of the loopback if it has none."""
    # Addresses of documentation: nothing is sent.
    family, outside, loopback = socket.AF_INET, "192.0.2.1", "127.0.0.1"
    if ":" in host:
        family, outside, loopback = socket.AF_INET6, "2001:db8::1", "::1"
    with socket.socket(family, socket.SOCK_DGRAM) as probe, suppress(OSError):
        probe.connect((outside, 1))
        return str(probe.getsockname()[0])
    return loopback
