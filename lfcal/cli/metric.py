"""`lfcal metric` and `lfcal board`: optics from flats of a board, and the board."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from ..runtime import command_line as cl
from ..runtime.types import Entries
from .figures import describe_blur, describe_optics
from .inputs import RESULTS, read_flats

if TYPE_CHECKING:
    from ..boards.board import Board
    from ..metric.result import MetricCalibration

__all__ = ["board", "metric"]

_JSON = (".json",)
_EXCHANGE = cl.OutputPath(suffixes=(".js", ".yml", ".yaml", ".xml"))
# Lenses are named by rounded focal lengths.
_FOCAL_LENGTH_TOLERANCE = 0.1
_BOARD = (
    cl.option(
        "--board corners",
        cl.Pair("COLUMNSxROWS", "9x6"),
        "Inner corners, such as 9x6.",
        required=True,
    ),
    cl.option("--square", cl.Quantity(after="mm"), "Side of a square [mm].", "MM", required=True),
    cl.option(
        "--pattern",
        click.Choice(["checkerboard", "charuco", "circles"]),
        "Circles: an asymmetric grid, --square is the distance of its rows.",
        default="checkerboard",
        show_default=True,
    ),
    cl.option(
        "--marker", cl.Quantity(after="mm"), "Side of markers, diameter of circles [mm].", "MM"
    ),
    cl.option(
        "--dictionary", str, "Of ChArUco markers, in OpenCV.", default="5X5_1000", show_default=True
    ),
)
_METRIC = (
    cl.option("-c --camera", cl.INPUT, "Camera file of 'lfcal calibrate'.", required=True),
    cl.option(*cl.DARK),
    # It may be written over: it is the same camera, with more known about it.
    cl.output_option("CAMERA.json", "Camera file to write.", replaces="camera", suffixes=_JSON),
    *_BOARD,
    cl.option(
        "--pixel",
        cl.Quantity(after="[uµ]m"),
        "Side of a pixel of the sensor [um]: the scale of F and L.",
        "UM",
    ),
    cl.option(
        "--focal-length",
        cl.Quantity(after="mm"),
        "Of the main lens, as written on it: a measured one that differs is warned of.",
        "MM",
    ),
    cl.option(
        "--exchange",
        _EXCHANGE,
        "For other programs: .js with poses beside it (libpleno), .yml or .xml (OpenCV's pinhole) "
        "to write.",
        "FILE",
    ),
    cl.option(
        "--report page",
        cl.OutputPath(suffixes=(".html",)),
        "Residuals, poses, what to shoot next.",
        "PAGE.html",
    ),
    cl.option(
        "--poses", cl.OutputPath(suffixes=_JSON), "Poses of the boards to write.", "POSES.json"
    ),
)


def _read_board(given: Any) -> Board:
    from ..boards.board import Board

    columns, rows = given.corners
    return Board(columns, rows, given.square, given.pattern, given.marker, given.dictionary)


@cl.command(
    "lfcal metric board_*.png -c camera.json --board 9x6 --square 12.0 -o camera.json",
    "lfcal metric board_*.png -c camera.json --board 9x6 --square 12 --pixel 5.5 -o metric.json "
    "--poses poses.json",
)
@cl.several_inputs("flats", "FLAT...")
@cl.with_options(*_METRIC)
@cl.report_options(RESULTS["metric"])
def metric(report: cl.Report, given: Any) -> None:
    """Measure the optics of a camera on FLATs of a board, for metres.

    Focal length, distances, distortion and tilt are fitted to several poses of the board. With the
    camera file that is written, depth and point clouds of its flats are in metres.
    """
    flats = given.flats
    camera = given.camera
    output = given.output
    board = _read_board(given)
    with report.stage("read"):
        from .. import calibrate_metric, load

        pixels = read_flats(given, *flats)
        calibration = load(camera, (pixels[0].shape[1], pixels[0].shape[0]))
    with report.stage("measure"), report.progress("boards") as step:
        pixel = given.pixel and given.pixel / 1000
        names = [flat.name for flat in flats]
        found = calibrate_metric(
            pixels, calibration, board, pixel=pixel, names=names, progress=step
        )
    with report.stage("write"):
        from ..metric.exchange import write_libpleno, write_pinhole
        from ..metric_report.report import write_metric_report

        found.calibration.save(output)
        if given.poses is not None:
            found.save_poses(given.poses)
        if given.page is not None:
            write_metric_report(given.page, found, title=f"Metric calibration of {camera.name}")
        if given.exchange is not None and given.exchange.suffix.lower() == ".js":
            write_libpleno(given.exchange, found)
        elif given.exchange is not None:
            write_pinhole(given.exchange, found.calibration)
    optics = found.optics
    if (
        given.focal_length
        and abs(optics.focal_length / given.focal_length - 1) > _FOCAL_LENGTH_TOLERANCE
    ):
        report.warn(
            f"the focal length is {optics.focal_length:.4g} mm, and not {given.focal_length:g} mm "
            "as stated: --pixel is wrong by as much, or the lens is zoomed"
        )
    blur = found.calibration.lens_blur
    distances = [pose.translation[2] / 1000 for pose in found.poses]
    report.finish(
        {"camera": str(output), **_describe(found)},
        f"{len(found.residual):,} corners on {len(found.poses)} flats "
        f"fit to {found.rms:.2f} px RMS.",
        f"Focal length {optics.focal_length:.2f} mm; microlenses {optics.mla_distance:.2f} mm "
        f"behind the main lens, {optics.sensor_distance:.3f} mm before the sensor.",
        f"Compare with a ruler: the boards stand {min(distances):.3g} to {max(distances):.3g} m "
        "before the main lens. A wrong --square scales these distances and shows nowhere else; a "
        "wrong --pixel scales the focal length.",
        *([describe_blur(blur)] if blur else []),
        f"{output} in {report.took}: depth of its flats is in metres.",
    )


@cl.command(
    "lfcal board --board 9x6 --square 12 -o board.pdf",
    "lfcal board --board 9x6 --square 15 --marker 11 --pattern charuco -o board.svg",
)
@cl.output_option("BOARD.pdf|.svg", "Page to write.")
@cl.with_options(*_BOARD)
@cl.report_options(RESULTS["board"])
def board(report: cl.Report, given: Any) -> None:
    """Make a board to print, for 'lfcal metric'.

    A bar of 100 mm on it tells whether it was printed in true size.
    """
    from ..boards.board import write_board

    target = _read_board(given)
    with report.stage("write"):
        write_board(given.output, target)
    closing = f"{given.output}: {target}. Print it in true size: the bar is 100 mm long."
    report.finish(
        {"written": str(given.output), "board": str(target), "square_mm": target.square}, closing
    )


def _describe(found: MetricCalibration) -> Entries:
    import numpy as np

    errors = np.array([pose.standard_errors for pose in found.poses])
    middle = np.median(errors / np.sqrt(found.widening), axis=0)
    return {
        "optics": describe_optics(found.optics),
        "flats_used": len(found.poses),
        "corners": len(found.residual),
        "outliers": int((~found.used).sum()),
        "rms_px": found.rms,
        "corner_noise_px": found.noise,
        "variance_widened_by": found.widening,
        "cramer_rao_position_mm": middle[3:],
        "cramer_rao_turn_degrees": np.rad2deg(middle[:3]),
        "distances_mm": [pose.translation[2] for pose in found.poses],
        "distance_errors_mm": [pose.standard_errors[5] for pose in found.poses],
        "warnings": [*found.warnings, *found.degeneracies],
    }
