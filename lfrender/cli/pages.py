"""`lfrender view`, `report` and `demo`: pages for the browser."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import click

from lfcal.runtime import console
from lfcal.runtime.output_file import check_output

from .figures import camera_figures, capture_figures
from .inputs import CaptureInput
from .options import OUTPUT, capture_command

__all__ = ["demo", "report", "view"]


@capture_command("lfrender view flat.png", "lfrender view flat.png -c camera.json --export page", preset=False)
@click.option(
    "--export", type=OUTPUT, metavar="FOLDER", help="Write the page as static files instead, for any web page."
)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port on this machine; by default any free one.")
@click.option("--no-browser", is_flag=True, help="Only print the address of the page, do not open a browser.")
def view(capture: CaptureInput, export: Path | None, port: int, no_browser: bool) -> None:
    """Refocus FLAT in the browser: click to focus, drag to look from aside.

    The page is served to this machine alone until Ctrl-C. It needs a browser with WebGL 2.
    """
    from ..web.viewer import viewer_files, write_viewer

    report = capture.report
    pixels, calibration, depth = capture.load()
    warnings = camera_figures(calibration, depth)["warnings"]
    if export is not None:
        with report.stage("write"):
            page = write_viewer(export, pixels, calibration, depth, capture.flat.name)
        report.finish({"page": str(page), "warnings": warnings})
        return
    from ..web.viewer_server import PageServer

    with report.stage("prepare"):
        server = PageServer(dict(viewer_files(pixels, calibration, depth, capture.flat.name)), port)
    with server:
        report.finish({"page": server.url, "warnings": warnings})
        if not no_browser:
            click.launch(server.url)
        if not (report.quiet or report.as_json):
            click.echo("Ctrl-C ends it")
        with suppress(KeyboardInterrupt):
            server.serve_forever()


@capture_command(
    "lfrender report flat.png -o report.html",
    "lfrender report flat.png -c camera.json -o report.html --preset accurate",
    output=("REPORT.html", "Page to write."),
    white=True,
)
def report(capture: CaptureInput, output: Path) -> None:
    """Write calibration, depth and pictures of FLAT on one page that opens offline."""
    from ..web.report import write_report
    from ..web.report_figures import draw_pictures

    check_output(output, {".html", ".htm"}, capture.files)
    progress = capture.report
    pixels, calibration, depth = capture.load()
    with progress.stage("render"):
        pictures = draw_pictures(pixels, calibration, depth)
    with progress.stage("write"):
        seconds = dict(progress.seconds)
        write_report(output, pixels, calibration, depth, pictures, title=capture.flat.name, seconds=seconds)
    progress.finish({"report": str(output), **capture_figures(calibration, depth)})


@click.command(epilog=console.help_examples("lfrender demo -o demo"))
@click.option(
    "-o",
    "--output",
    type=OUTPUT,
    default=Path("lfrender-demo"),
    show_default=True,
    help="Folder for pictures and page.",
)
@console.report_options
def demo(output: Path, as_json: bool, quiet: bool) -> None:
    """Simulate a capture, calibrate, analyse and render it, and show pictures and figures on an HTML page."""
    from ..web.demo import run_demo

    report = console.Report(as_json, quiet, log_stages=True)
    report.finish(run_demo(output, report))
