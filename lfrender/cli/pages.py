"""`lfrender view`, `report` and `demo`: something to look at in a browser."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from lfcal.runtime import console
from lfcal.runtime.output_file import check_output

from .figures import camera_figures, depth_figures
from .inputs import analysed, camera_of, in_colour, read_depth
from .options import CAMERA, INPUT, OUTPUT, WITHOUT_CAMERA, at_most_one, flat_argument, preset_option

__all__ = ["demo", "report", "view"]


@click.command(
    epilog=console.help_examples(
        "lfrender view flat.png",
        "lfrender view flat.png -c camera.json --export page",
    )
)
@flat_argument
@click.option("-c", "--camera", type=INPUT, help=CAMERA + WITHOUT_CAMERA)
@click.option("--depth", "depth_file", type=INPUT, help="Depth map made by 'lfrender analyze'.")
@click.option(
    "--export", type=OUTPUT, metavar="FOLDER", help="Write the page as static files instead, for any web page."
)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port on this machine; by default any free one.")
@click.option("--no-browser", is_flag=True, help="Do not open a browser, only say where the page is.")
@console.report_options
def view(
    flat: Path,
    camera: Path | None,
    depth_file: Path | None,
    export: Path | None,
    port: int,
    no_browser: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Refocus FLAT in the browser: click to focus, drag to look from aside.

    The page is served to this machine alone until Ctrl-C. It needs a browser with WebGL 2.
    """
    from ..web.viewer import viewer_files, write_viewer

    report = console.Report(as_json, quiet)
    pixels, calibration, depth = _capture(report, flat, camera, depth_file)
    if export is not None:
        with report.stage("write"):
            page = write_viewer(export, pixels, calibration, depth, flat.name)
        report.finish({"page": str(page), "warnings": camera_figures(calibration, depth)["warnings"]})
        return
    from ..web.viewer_server import PageServer

    with report.stage("prepare"):
        server = PageServer(dict(viewer_files(pixels, calibration, depth, flat.name)), port)
    with server:
        report.finish({"page": server.url, "warnings": camera_figures(calibration, depth)["warnings"]})
        if not no_browser:
            click.launch(server.url)
        if not (quiet or as_json):
            click.echo("Ctrl-C ends it")
        # Ctrl-C is how it is meant to end.
        with suppress(KeyboardInterrupt):
            server.serve_forever()


@click.command(
    epilog=console.help_examples(
        "lfrender report flat.png -o report.html",
        "lfrender report flat.png -c camera.json -o report.html --preset accurate",
    )
)
@flat_argument
@click.option("-o", "--output", type=OUTPUT, required=True, metavar="REPORT.html", help="Page to write.")
@click.option("-c", "--camera", type=INPUT, help=CAMERA + WITHOUT_CAMERA)
@click.option("--white", type=INPUT, help="Calibrate from this white image of the same camera.")
@click.option("--depth", "depth_file", type=INPUT, help="Depth map made by 'lfrender analyze'.")
@preset_option
@console.report_options
def report(
    flat: Path,
    output: Path,
    camera: Path | None,
    white: Path | None,
    depth_file: Path | None,
    preset: str,
    as_json: bool,
    quiet: bool,
) -> None:
    """Write calibration, depth and pictures of FLAT on one page that opens offline."""
    from ..web.report import write_report
    from ..web.report_pictures import draw_pictures

    progress = console.Report(as_json, quiet)
    at_most_one("--camera", camera, "--white", white)
    check_output(output, {".html", ".htm"}, [flat, camera, white, depth_file])
    pixels, calibration, depth = _capture(progress, flat, camera, depth_file, white=white, preset=preset)
    with progress.stage("render"):
        pictures = draw_pictures(pixels, calibration, depth)
    with progress.stage("write"):
        write_report(output, pixels, calibration, depth, pictures, title=flat.name, seconds=dict(progress.seconds))
    progress.finish({"report": str(output), **camera_figures(calibration, depth), **depth_figures(depth)})


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
    """Simulate a capture, run the whole chain on it, and show pictures and figures on an HTML page."""
    from ..web.demo import run_demo

    report = console.Report(as_json, quiet, log_stages=True)
    report.finish(run_demo(output, report))


def _capture(report: Any, flat: Path, camera: Path | None, depth_file: Path | None, **options: Any) -> Any:
    """The flat in colour, its camera and its depth."""
    from lfcal import read_flat

    with report.stage("read"):
        pixels = read_flat(flat)
    with report.stage("calibrate"):
        calibration = camera_of(report, flat, pixels, camera, options.get("white"), None)
        pixels = in_colour(pixels, calibration)
    with report.stage("analyze"):
        depth = (
            read_depth(depth_file)
            if depth_file
            else analysed(report, pixels, calibration, options.get("preset", "balanced"))
        )
    return pixels, calibration, depth
