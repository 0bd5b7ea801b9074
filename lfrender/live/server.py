"""The live page: pictures as JPEG, the status as JSON, and commands.

A page asks for the picture after the last one that it has shown, and waits until there is one: a
slow browser gets fewer pictures and does not delay others.
"""

from __future__ import annotations

from http.client import BAD_REQUEST, INTERNAL_SERVER_ERROR, NO_CONTENT, NOT_FOUND

from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response

from lfcal import LightFieldError

from ..runtime.messages import one_line
from ..web.server import WebServer
from ..web.templates import fill, import_map, read_asset
from .session import COMMANDS, KINDS, Place, Session

__all__ = ["LiveServer"]


class LiveServer(WebServer):
    """Serves the page of a session; the rest is as for `WebServer`."""

    def __init__(
        self, session: Session, title: str, host: str = "127.0.0.1", port: int = 0
    ) -> None:
        self._session = session
        self._page = str(
            fill(
                "live.html",
                title=title,
                style=read_asset("viewer.css"),
                script=read_asset("live.js"),
                modules=import_map(("geometry", "readout")),
            )
        )
        routes = {
            ("GET", "/"): lambda _: HTMLResponse(self._page),
            ("GET", "/status"): lambda _: JSONResponse(session.status()),
            ("GET", "/frame"): self._frame,
            ("GET", "/depth"): self._depth,
        }
        commands = {("POST", f"/{name}"): self._command for name in COMMANDS}
        super().__init__({**routes, **commands}, host, port)

    def _frame(self, request: Request) -> Response:
        values = request.query_params
        kind = values.get("kind")
        if kind not in KINDS:
            message = f"kind is one of {', '.join(KINDS)}"
            return JSONResponse({"message": message}, NOT_FOUND)
        try:
            after = int(values.get("after", 0))
            plane = values.get("plane")
            focus = _place(request) if plane is None else float(plane)
        except ValueError as error:
            return JSONResponse({"message": str(error)}, BAD_REQUEST)
        try:
            found = self._session.picture(kind, after, focus)
        # An error of one picture, such as a place without depth, is shown, and the page goes on.
        except Exception as error:
            return JSONResponse({"message": one_line(error)}, INTERNAL_SERVER_ERROR)
        if found is None:
            return Response(status_code=NO_CONTENT)
        view, data = found
        headers = {"X-Frame": str(view.shot.number)}
        if kind == "focus" and view.knows_depth:
            headers["X-Plane"] = str(view.patch_size(focus))
        return Response(data, media_type="image/jpeg", headers=headers)

    def _depth(self, request: Request) -> Response:
        try:
            place = _place(request)
        except ValueError as error:
            return JSONResponse({"message": str(error)}, BAD_REQUEST)
        view = self._session.view
        if view is None or not view.knows_depth:
            return Response(status_code=NO_CONTENT)
        return JSONResponse(view.depth_at(place))

    def _command(self, request: Request) -> Response:
        try:
            self._session.command(request.url.path[1:])
        except LightFieldError as error:
            return JSONResponse({"message": str(error)}, INTERNAL_SERVER_ERROR)
        return JSONResponse(self._session.status())


def _place(request: Request) -> Place:
    """The place in the picture that a request names, by default its middle."""
    values = request.query_params
    place = float(values.get("x", 0.5)), float(values.get("y", 0.5))
    if not all(0 <= share <= 1 for share in place):
        raise ValueError("x and y are shares of width and height")
    return place
