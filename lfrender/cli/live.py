"""`lfrender live`: pictures of a camera in the browser, while it runs."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click
import cloup

from lfcal.runtime import command_line as cl
from lfcal.runtime.command_line.interrupts import end_by_interrupt
from lfcal.runtime.output_file import make_folder

from ..runtime.types import Entries
from .inputs import CaptureInput
from .options import RESULTS, declare, refuse_together

if TYPE_CHECKING:
    from lfcal import Calibration
    from lfcal.runtime.image_formats import Mosaic

    from ..live.sources import Shot

__all__ = ["live"]


@cl.command(
    "lfrender live 0",
    "lfrender live rtsp://camera/stream -c camera.json",
    "lfrender live arv: --pixel-format Mono12 -o recordings",
    "lfrender live frames --fps 5",
)
@click.argument("source", metavar="SOURCE")
@cloup.option_group(
    "Files",
    *(declare(name, "the first frame") for name in ("live_folder", "camera", "white", "dark")),
)
@cloup.option_group("Frames", *(declare(name) for name in ("live_format", "live_rate", "mosaic")))
@cloup.option_group("Depth analysis", declare("live_preset"))
@cloup.option_group(
    "Where to show it", *(declare(name) for name in ("live_exposure", "host", "port", "no_browser"))
)
@cl.report_options(RESULTS["page"])
def live(report: cl.Report, given: Any) -> None:
    """Show a camera in the browser: raw, traditional, sharp, depth, in focus where you click.

    SOURCE is the number, file, address or GStreamer pipeline of a camera or stream that OpenCV
    reads; a GenICam camera, as PRODUCER.cti[:DEVICE] or with Aravis as arv:[DEVICE]; or files, a
    folder or a video, in a loop. The newest frame is drawn, others are counted as lost. The page is
    served to this machine alone until Ctrl-C.
    """
    from ..live.grabber import Grabber
    from ..live.server import LiveServer
    from ..live.session import Session
    from ..live.sources import open_source

    refuse_together(vars(given), "camera white")
    source = given.source
    files = {name: getattr(given, name) for name in ("camera", "white", "dark", "mosaic")}
    capture = CaptureInput(report, Path(source), **files)
    report.compile_kernels()
    with report.stage("open"):
        make_folder(given.output)
        grabber = Grabber(lambda: open_source(source, given.pixel_format, given.fps))
        # A dark frame of another camera is refused now.
        capture.subtract_dark(grabber.first.pixels)
    known = bool(given.camera or given.white or capture.recording)
    session = Session(
        grabber,
        lambda shot: find_camera(capture, shot),
        given.preset or "fast",
        given.output,
        given=known,
        exposure=given.exposure,
        correct=capture.subtract_dark,
    )
    with (
        closing(session),
        LiveServer(session, _short_name(source), given.host, given.port) as server,
    ):
        with report.stage("calibrate"):
            session.start(strict=bool(given.camera or given.white))
        figures: Entries = {"page": server.url, "warnings": []}
        if session.camera is not None:
            figures["warnings"] += session.camera.warnings
        report.finish(figures, f"{session.about}.", f"{server.url} until Ctrl-C.")
        if not given.no_browser:
            click.launch(server.url)
        with end_by_interrupt():
            server.wait()


def _short_name(source: str) -> str:
    """The name of a file or folder without the way to it; other sources as they are named."""
    if Path(source).exists():
        return Path(source).resolve().name
    return source


def find_camera(capture: CaptureInput, shot: Shot) -> Calibration:
    """The camera of a frame, with what the source tells about its pixels."""
    if capture.mosaic is None and shot.mosaic is not None:
        capture = replace(capture, mosaic=cast("Mosaic", shot.mosaic))
    camera = capture.find_camera(shot.pixels)
    if camera.white_level is None:
        camera = replace(camera, white_level=shot.white)
    if camera.encoded is None:
        camera = replace(camera, encoded=shot.encoded)
    return camera
