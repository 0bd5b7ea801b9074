"""`lfcal metric` and `lfcal board`: measure the optics of a camera on flats of a board, and make the board."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..runtime import console
from ..runtime.output_file import check_output

if TYPE_CHECKING:
    from ..boards.board import Board
    from ..metric.result import MetricCalibration

__all__ = ["board", "metric"]

_INPUT, _OUTPUT = console.InputPath(), console.OutputPath(".json")
_PATTERNS = ("checkerboard", "charuco", "circles")


def board_options(command: Any) -> Any:
    """Give a command the options that describe a board."""
    for option in reversed(
        [
            click.option("--board", "size", required=True, metavar="COLUMNSxROWS", help="Inner corners, such as 9x6."),
            click.option("--square", type=float, required=True, metavar="MM", help="Side of a square [mm]."),
            click.option(
                "--pattern",
                type=click.Choice(_PATTERNS),
                default="checkerboard",
                show_default=True,
                help="Circles: an asymmetric grid, --square is the distance of its rows.",
            ),
            click.option("--marker", type=float, metavar="MM", help="Side of markers, diameter of circles [mm]."),
            click.option("--dictionary", default="5X5_1000", show_default=True, help="Of ChArUco markers, in OpenCV."),
        ]
    ):
        command = option(command)
    return command


def read_board(size: str, square: float, pattern: Any, marker: float | None, dictionary: str) -> Board:
    """The board of the options."""
    from ..boards.board import Board

    columns, _, rows = size.lower().partition("x")
    try:
        counts = int(columns), int(rows)
    except ValueError as error:
        raise click.UsageError(f"--board {size}: give its inner corners across and down, such as 9x6") from error
    return Board(*counts, square, pattern, marker, dictionary)


@console.command(
    "lfcal metric board_*.png -c camera.json --board 9x6 --square 12.0 -o camera.json",
    "lfcal metric board_*.png -c camera.json --board 9x6 --square 12 --pixel 5.5 -o metric.json --poses poses.json",
)
@console.several_inputs("flats", "FLAT...")
@click.option("-c", "--camera", type=_INPUT, required=True, help="Camera file of 'lfcal calibrate'.")
@click.option("-o", "--output", type=_OUTPUT, required=True, metavar="CAMERA.json", help="Camera file to write.")
@board_options
@click.option("--pixel", type=float, metavar="UM", help="Side of a pixel of the sensor [um]: the scale of F, L and b.")
@click.option(
    "--exchange",
    type=_OUTPUT,
    metavar="FILE",
    help="For other programs: .js with poses beside it (libpleno), .yml or .xml (OpenCV's pinhole) to write.",
)
@click.option("--report", "page", type=_OUTPUT, metavar="PAGE.html", help="Residuals, poses, what to shoot next.")
@click.option("--poses", type=_OUTPUT, metavar="POSES.json", help="Poses of the boards to write.")
@console.report_options
def metric(
    flats: tuple[Path, ...],
    camera: Path,
    output: Path,
    size: str,
    square: float,
    pattern: str,
    marker: float | None,
    dictionary: str,
    pixel: float | None,
    exchange: Path | None,
    page: Path | None,
    poses: Path | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Measure the optics of a camera on FLATs of a board, for metres.

    Focal length, distances, distortion and tilt are fitted to several poses of the board. With the camera file that is
    written, depth and point clouds of its flats are in metres.
    """
    report = console.Report(as_json, quiet)
    # The camera may be written over: it is the same one, which knows more.
    check_output(output, {".json"}, flats)
    if poses is not None:
        check_output(poses, {".json"}, [*flats, camera, output])
    if page is not None:
        check_output(page, {".html"}, [*flats, camera])
    if exchange is not None:
        check_output(exchange, {".js", ".yml", ".yaml", ".xml"}, [*flats, camera])
    board = read_board(size, square, pattern, marker, dictionary)
    with report.stage("read"):
        from .. import load, read_flat

        pixels = [read_flat(flat) for flat in flats]
        calibration = load(camera, (pixels[0].shape[1], pixels[0].shape[0]))
    with report.stage("measure"):
        from .. import calibrate_metric

        found = calibrate_metric(
            pixels,
            calibration,
            board,
            pixel=None if pixel is None else pixel / 1000,
            names=[flat.name for flat in flats],
        )
    with report.stage("write"):
        found.calibration.save(output)
        if poses is not None:
            found.save_poses(poses)
        if page is not None:
            from ..metric_report.report import write_metric_report

            write_metric_report(page, found, title=f"Metric calibration of {camera.name}")
        if exchange is not None:
            from ..metric.exchange import write_libpleno, write_pinhole

            if exchange.suffix.lower() == ".js":
                write_libpleno(exchange, found)
            else:
                write_pinhole(exchange, found.calibration)
    optics = found.optics
    report.finish(
        {"camera": str(output), **describe_metric(found)},
        f"{len(found.residual):,} corners on {len(found.poses)} flats fit to {found.rms:.2f} px RMS.",
        f"Focal length {optics.focal_length:.2f} mm; microlenses {optics.mla_distance:.2f} mm behind the main lens, "
        f"{optics.sensor_distance:.3f} mm before the sensor.",
        f"{output} in {report.took}: depth of its flats is in metres.",
    )


@console.command(
    "lfcal board --board 9x6 --square 12 -o board.pdf",
    "lfcal board --board 9x6 --square 15 --marker 11 --pattern charuco -o board.svg",
)
@click.option("-o", "--output", type=_OUTPUT, required=True, metavar="BOARD.pdf|.svg", help="Page to write.")
@board_options
@console.report_options
def board(
    output: Path,
    size: str,
    square: float,
    pattern: str,
    marker: float | None,
    dictionary: str,
    as_json: bool,
    quiet: bool,
) -> None:
    """Make a board to print, for 'lfcal metric'.

    A bar of 100 mm on it tells whether it was printed in true size.
    """
    report = console.Report(as_json, quiet)
    check_output(output, {".pdf", ".svg"})
    target = read_board(size, square, pattern, marker, dictionary)
    with report.stage("write"):
        from ..boards.printed import write_board

        write_board(output, target)
    report.finish(
        {"written": str(output), "board": str(target), "square_mm": target.square},
        f"{output}: {target}. Print it in true size: the bar is 100 mm long.",
    )


def describe_metric(found: MetricCalibration) -> dict[str, Any]:
    """The figures that are printed: parameters with their errors, poses with their Cramer-Rao bounds."""
    import numpy as np

    from .figures import describe_optics

    bound = np.array([pose.standard_errors for pose in found.poses]) / np.sqrt(found.widening)
    return {
        **describe_optics(found.optics),
        "flats_used": len(found.poses),
        "corners": len(found.residual),
        "outliers": int((~found.used).sum()),
        "rms_px": round(found.rms, 4),
        "corner_noise_px": round(found.noise, 4),
        "variance_widened_by": round(found.widening, 2),
        "cramer_rao_position_mm": np.round(np.median(bound[:, 3:], axis=0), 4).tolist(),
        "cramer_rao_turn_degrees": np.round(np.rad2deg(np.median(bound[:, :3], axis=0)), 4).tolist(),
        "distances_mm": [round(float(pose.translation[2]), 2) for pose in found.poses],
        "distance_errors_mm": [round(float(pose.standard_errors[5]), 3) for pose in found.poses],
        "warnings": [*found.warnings, *found.degeneracies],
    }
