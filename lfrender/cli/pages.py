"""`lfrender view`, `report` and `demo`: pages for the browser."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import click

from lfcal.runtime import console
from lfcal.runtime.output_file import check_output

from .figures import camera_figures, camera_sentence, capture_figures, depth_sentences, percent
from .inputs import CaptureInput
from .options import OUTPUT, capture_command

__all__ = ["demo", "report", "view"]


@capture_command("lfrender view flat.png", "lfrender view flat.png -c camera.json --export page.html", preset=False)
@console.grouped(
    "Where to show it",
    click.option(
        "--export",
        type=OUTPUT,
        metavar="FOLDER|PAGE.html",
        help="Write the page instead: as one file that holds everything, or as a folder of static files for web pages.",
    ),
    click.option(
        "--port", type=click.IntRange(0, 65535), default=0, help="Port on this machine; by default a free one."
    ),
    click.option("--no-browser", is_flag=True, help="Only print the address of the page, do not open a browser."),
)
def view(capture: CaptureInput, export: Path | None, port: int, no_browser: bool) -> None:
    """Refocus FLAT in the browser, with mouse or fingers.

    Click to focus, drag to look from aside. The page is served to this machine alone until Ctrl-C. It needs a browser
    with WebGL 2.
    """
    from ..web.viewer import viewer_files, write_viewer

    report = capture.report
    if export is not None and export.suffix:
        check_output(export, {".html", ".htm"}, capture.files)
    pixels, calibration, depth = capture.load()
    warnings = camera_figures(calibration, depth)["warnings"]
    sentences = [camera_sentence(calibration, capture.camera), *depth_sentences(calibration, depth)]
    if export is not None:
        with report.stage("write"):
            page = write_viewer(export, pixels, calibration, depth, capture.flat.name)
        closing = f"{page} in {report.took}: open it in a browser, or put it on a web page."
        report.finish({"page": str(page), "warnings": warnings}, *sentences, closing)
        return
    from ..web.viewer_server import PageServer

    with report.stage("prepare"):
        server = PageServer(dict(viewer_files(pixels, calibration, depth, capture.flat.name)), port)
    with server:
        report.finish({"page": server.url, "warnings": warnings}, *sentences, f"{server.url} until Ctrl-C.")
        if not no_browser:
            click.launch(server.url)
        with suppress(KeyboardInterrupt):
            server.serve_forever()


@capture_command(
    "lfrender report flat.png -o report.html",
    "lfrender report flat.png -c camera.json -o report.html --preset fast",
    output=("REPORT.html", "Page to write.", ".html"),
    white=True,
)
def report(capture: CaptureInput, output: Path) -> None:
    """Write depth, pictures and calibration of FLAT as one page.

    The page holds everything and opens offline.
    """
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
    progress.finish(
        {"report": str(output), **capture_figures(calibration, depth)},
        camera_sentence(calibration, capture.camera), *depth_sentences(calibration, depth),
        f"{output} in {progress.took}: open it in a browser.",
    )  # fmt: skip


@console.command("lfrender demo -o demo")
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
    """Try everything on a simulated capture, and show it on a page.

    The capture is calibrated, analysed and rendered from its pixels alone, and compared with the truth.
    """
    from ..web.demo import run_demo

    report = console.Report(as_json, quiet, log_stages=True)
    figures = run_demo(output, report)
    modes, merit = figures["mode_right"]["one_depth"], figures["merit"]["all_in_focus"]["psnr"]
    centres = figures["calibration"]["scene"]["centre_error"]
    report.finish(
        figures,
        f"{figures['lenses']:,} microlenses, {figures['pitch']:.1f} px apart, found to {centres:.3f} px RMS from "
        "the capture alone.",
        f"The mode is right in {percent(modes)} of the lenses that see one depth; the picture is {merit:.1f} dB "
        "from the truth.",
        f"{figures['page']} in {report.took}, {report.seconds['simulate']:.1f} s of it for the simulation.",
    )
