"""`lfrender view`, `report` and `demo`: pages for the browser."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfcal import LightFieldError
from lfcal.runtime import command_line as cl
from lfcal.runtime.command_line.interrupts import end_by_interrupt
from lfcal.runtime.output_file import check_folder, check_output

from . import figures
from .inputs import CaptureInput
from .options import RESULTS, capture_command

if TYPE_CHECKING:
    from lfcal import Calibration

__all__ = ["demo", "report", "view"]


@capture_command(
    "page",
    "lfrender view flat.png",
    "lfrender view flat.png -c camera.json --export page.html",
    "lfrender view frames -c camera.json",
    refused={"roi": "the viewer shows the whole flat; zoom into it"},
    own={"Where to show it": "export port no_browser"},
    several="FLAT...",
)
def view(capture: CaptureInput, given: Any) -> None:
    """Refocus FLAT in the browser, with mouse or fingers.

    Click to focus, drag to look from aside. Of several flats, or a folder of them, the page leads
    from one to the next, and each is analysed when it is looked at. The page is served to this
    machine alone until Ctrl-C. It needs a browser with WebGL 2.
    """
    from ..web.server import WebServer, page_routes
    from ..web.viewer import FlatPages, write_viewer

    report = capture.report
    export = given.export
    flats = _find_flats(given.inputs)
    several = len(flats) > 1
    page = export is not None and export.suffix != ""
    if page:
        check_output(export, {".html", ".htm"})
    elif export is not None:
        check_folder(export, parents=True)
    if several and page:
        raise click.UsageError(f"{export} holds one flat: give a folder to --export")
    if several and capture.depth_file is not None:
        raise click.UsageError(
            "--depth is for one flat: leave it out, each is analysed when it is looked at"
        )
    if several:
        load = _loader(capture, flats)
        found = {}
        sentences = [f"{len(flats)} flats, analysed when they are looked at."]
    else:
        capture = replace(capture, flat=flats[0])
        loaded = capture.load()
        known, sentences = capture.describe(*loaded[1:])
        load = [loaded].__getitem__
        found = {"warnings": known["warnings"]}
    one_folder = len({flat.parent for flat in flats}) == 1
    pages = FlatPages([flat.name if one_folder else str(flat) for flat in flats], load)
    if export is not None:
        with report.stage("write"):
            path = write_viewer(export, *loaded, flats[0].name) if page else pages.write(export)
        closing = f"{path} in {report.took}: open it in a browser, or put it on a web page."
        report.finish({"page": str(path), **found}, *sentences, closing)
        return
    with WebServer(page_routes(pages), port=given.port) as server:
        if not several:
            with report.stage("prepare"):
                pages.get("data/1/scene.json.js")
        report.finish({"page": server.url, **found}, *sentences, f"{server.url} until Ctrl-C.")
        if not given.no_browser:
            click.launch(server.url)
        with end_by_interrupt():
            server.wait()


def _find_flats(inputs: Iterable[Path]) -> list[Path]:
    """The named flats and those in folders, sorted by the numbers in their names."""
    from ..sequence.frames import open_frames

    flats: list[Path] = []
    for path in inputs:
        if path.is_dir() and path.suffix.lower() != ".zarr":
            flats += open_frames([path]).files
        else:
            flats.append(path)
    return flats


def _loader(capture: CaptureInput, flats: list[Path]) -> Callable[[int], Any]:
    """A function that loads a flat; a camera without a file is found on the first one."""
    found: list[Calibration] = []

    def load(number: int) -> Any:
        one = replace(capture, flat=flats[number])
        try:
            with cl.name_file_in_errors(one.flat):
                pixels, calibration = one.calibrate(one.read(), *found)
                depth = one.analyze(pixels, calibration)
        except (LightFieldError, OSError) as error:
            cl.echo(error, err=True)
            raise
        if capture.camera is None:
            found[:] = [calibration]
        for text in figures.capture_figures(calibration, depth)["warnings"]:
            cl.echo(f"warning: {one.flat}: {text}", err=True)
        return pixels, calibration, depth

    return load


@capture_command(
    "report",
    "lfrender report flat.png -o report.html",
    "lfrender report flat.png -c camera.json -o report.html --preset fast",
    output=("REPORT.html", "Page to write.", ".html", "", (".html", ".htm")),
    refused={"roi": "the report is about the whole flat"},
)
def report(capture: CaptureInput, given: Any) -> None:
    """Write depth, pictures and calibration of FLAT as one page.

    The page holds everything and opens offline.
    """
    from ..web.report import write_report
    from ..web.report_pictures import draw_pictures

    progress = capture.report
    output = given.output
    pixels, calibration, depth = capture.load()
    with progress.stage("render"):
        pictures = draw_pictures(pixels, calibration, depth)
    with progress.stage("write"):
        seconds = dict(progress.seconds)
        write_report(
            output, pixels, calibration, depth, pictures, title=capture.flat.name, seconds=seconds
        )
    closing = f"{output} in {progress.took}: open it in a browser."
    capture.conclude({"report": output}, calibration, depth, closing)


@cl.command("lfrender demo -o demo")
@cl.output_option(
    "FOLDER",
    "Folder for pictures and page.",
    required=False,
    default=Path("lfrender-demo"),
    show_default=True,
)
@cl.report_options(RESULTS["demo"])
def demo(report: cl.Report, given: Any) -> None:
    """Try everything on a simulated capture, and show it on a page.

    The capture is calibrated, analysed and rendered from its pixels alone, and compared with the
    truth.
    """
    from ..web.demo import run_demo

    found = run_demo(given.output, report)
    right = found["mode_right"]
    merit = found["merit"]["all_in_focus"]["psnr"]
    centres = found["calibration"]["scene"]["centre_error"]
    report.finish(
        found,
        f"{found['lenses']:,} microlenses, {found['pitch']:.1f} px apart, found to {centres:.3f} "
        "px RMS from the capture alone.",
        f"The mode is right in {figures.percent(right['one_depth'])} of the lenses that see one "
        f"depth, {figures.percent(right['all'])} of all that see detail; the picture is "
        f"{merit:.1f} dB from the truth.",
        f"{found['page']} in {report.took}, {report.seconds['simulate']:.1f} s of it for the "
        "simulation.",
    )
