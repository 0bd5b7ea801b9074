"""`lfrender view`, `report` and `demo`: pages for the browser."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfcal import LightFieldError
from lfcal.runtime import command_line as cl
from lfcal.runtime.output_file import check_output

from . import figures
from .inputs import CaptureInput
from .options import capture_command, output_option

if TYPE_CHECKING:
    from lfcal import Calibration

__all__ = ["demo", "report", "view"]


@capture_command(
    "lfrender view flat.png",
    "lfrender view flat.png -c camera.json --export page.html",
    "lfrender view frames -c camera.json",
    refused={"roi": "the viewer shows the whole flat; zoom into it"},
    own={"Where to show it": "export port no_browser"},
    several="FLAT...",
)
def view(capture: CaptureInput, given: Any) -> None:
    """Refocus FLAT in the browser, with mouse or fingers.

    Click to focus, drag to look from aside. Of several flats, or a folder of them, the page leads from one to the next,
    and each is analysed when it is looked at. The page is served to this machine alone until Ctrl-C. It needs a
    browser with WebGL 2.
    """
    from ..web.viewer import viewer_files, write_viewer
    from ..web.viewer_server import PageServer

    report, export, flats = capture.report, given.export, _find_flats(given.inputs)
    if export is not None and export.suffix:
        check_output(export, {".html", ".htm"}, [*flats, *capture.files])
    if len(flats) > 1:
        _view_several(capture, given, flats)
        return
    capture = replace(capture, flat=flats[0])
    pixels, calibration, depth = capture.load()
    warnings = figures.capture_figures(calibration, depth)["warnings"]
    sentences = figures.capture_sentences(capture, calibration, depth)
    if export is not None:
        with report.stage("write"):
            page = write_viewer(export, pixels, calibration, depth, capture.flat.name)
        closing = f"{page} in {report.took}: open it in a browser, or put it on a web page."
        report.finish({"page": str(page), "warnings": warnings}, *sentences, closing)
        return
    with report.stage("prepare"):
        server = PageServer(dict(viewer_files(pixels, calibration, depth, capture.flat.name)), given.port)
    report.finish({"page": server.url, "warnings": warnings}, *sentences, f"{server.url} until Ctrl-C.")
    _serve(server, given)


def _serve(server: Any, given: Any) -> None:
    with server, suppress(KeyboardInterrupt):
        if not given.no_browser:
            click.launch(server.url)
        server.serve_forever()


def _find_flats(inputs: Iterable[Path]) -> list[Path]:
    """The flats that are named, and those in folders, in the order of the numbers in their names."""
    from ..sequence.frames import open_frames

    folders = {path for path in inputs if path.is_dir() and path.suffix.lower() != ".zarr"}
    return [flat for path in inputs for flat in (open_frames([path]).files if path in folders else [path])]


def _view_several(capture: CaptureInput, given: Any, flats: list[Path]) -> None:
    """Show flats one after the other; a camera that is no file is found on the first of them that is looked at."""
    from ..web.viewer import FlatPages
    from ..web.viewer_server import PageServer

    report, export = capture.report, given.export
    found: list[Calibration] = []
    if capture.depth_file is not None:
        raise click.UsageError("--depth is for one flat: leave it out, each is analysed when it is looked at")

    def load(number: int) -> Any:
        one = replace(capture, flat=flats[number])
        try:
            with cl.name_file_in_errors(one.flat):
                pixels, calibration = one.calibrate(one.read(), *found)
                depth = one.analyze(pixels, calibration)
        except (LightFieldError, OSError) as error:
            click.echo(error, err=True)
            raise
        found[:] = [calibration] if capture.camera is None else []
        for text in figures.capture_figures(calibration, depth)["warnings"]:
            click.echo(f"warning: {one.flat}: {text}", err=True)
        return pixels, calibration, depth

    folders = {path.parent for path in flats}
    pages = FlatPages([str(path) if len(folders) > 1 else path.name for path in flats], load)
    if export is None:
        server = PageServer(pages, given.port)
        report.finish({"page": server.url, "flats": len(flats)}, f"{len(flats)} flats at {server.url} until Ctrl-C.")
        _serve(server, given)
        return
    if export.suffix:
        raise click.UsageError(f"{export} holds one flat: give a folder to --export")
    page = pages.write(export)
    report.finish({"page": str(page), "flats": len(flats)}, f"{page} in {report.took}: open it in a browser.")


@capture_command(
    "lfrender report flat.png -o report.html",
    "lfrender report flat.png -c camera.json -o report.html --preset fast",
    output=("REPORT.html", "Page to write.", ".html"),
    refused={"roi": "the report is about the whole flat"},
)
def report(capture: CaptureInput, given: Any) -> None:
    """Write depth, pictures and calibration of FLAT as one page.

    The page holds everything and opens offline.
    """
    from ..web.report import write_report
    from ..web.report_pictures import draw_pictures

    progress, output = capture.report, given.output
    check_output(output, {".html", ".htm"}, capture.files)
    pixels, calibration, depth = capture.load()
    with progress.stage("render"):
        pictures = draw_pictures(pixels, calibration, depth)
    with progress.stage("write"):
        seconds = dict(progress.seconds)
        write_report(output, pixels, calibration, depth, pictures, title=capture.flat.name, seconds=seconds)
    sentences = figures.capture_sentences(capture, calibration, depth)
    found = {"report": str(output), **figures.capture_figures(calibration, depth)}
    progress.finish(found, *sentences, f"{output} in {progress.took}: open it in a browser.")


@cl.command("lfrender demo -o demo")
@output_option(
    "FOLDER", "Folder for pictures and page.", required=False, default=Path("lfrender-demo"), show_default=True
)
@cl.report_options
def demo(report: cl.Report, given: Any) -> None:
    """Try everything on a simulated capture, and show it on a page.

    The capture is calibrated, analysed and rendered from its pixels alone, and compared with the truth.
    """
    from ..web.demo import run_demo

    found = run_demo(given.output, report)
    right, merit = found["mode_right"], found["merit"]["all_in_focus"]["psnr"]
    centres = found["calibration"]["scene"]["centre_error"]
    report.finish(
        found,
        f"{found['lenses']:,} microlenses, {found['pitch']:.1f} px apart, found to {centres:.3f} px RMS from "
        "the capture alone.",
        f"The mode is right in {figures.percent(right['one_depth'])} of the lenses that see one depth, "
        f"{figures.percent(right['all'])} of all that see detail; the picture is {merit:.1f} dB from the truth.",
        f"{found['page']} in {report.took}, {report.seconds['simulate']:.1f} s of it for the simulation.",
    )
