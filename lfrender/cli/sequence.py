"""`lfrender batch`: the frames of a sequence, here, on several processes or on a cluster."""

from __future__ import annotations

from contextlib import suppress
from time import perf_counter
from typing import TYPE_CHECKING, Any

import click

from lfcal import CameraFileError, FlatError
from lfcal.runtime.output_file import check_folder

from .figures import percent
from .inputs import CaptureInput
from .options import capture_command, connect_cluster

if TYPE_CHECKING:
    from lfcal import Calibration

    from ..sequence.frames import Frames

__all__ = ["batch"]


@capture_command(
    "lfrender batch frames -o pictures",
    "lfrender batch film.mkv -c camera.json -o pictures --format png",
    "lfrender batch film.mkv -c camera.json -o sharp.mp4",
    "lfrender batch frames/*.png -o pictures --workers 4",
    "lfrender batch film_2048x2048_420p10.yuv -c camera.cfg -o views --views 5x5 --format yuv --resize 1920x1080",
    output=("FOLDER|FILM", "Folder for the pictures, or a film: .mp4, or .mkv without any loss."),
    own={
        "Files": "overwrite",
        "What to draw": "scale frame_format eight_bits fps frame_views frame_aperture resize",
        "Several processes": "workers scheduler",
    },
    refused={
        "depth_file": "the depth of every frame is analysed",
        "page": "every page and every frame of a video is rendered; 'lfrender render' takes one",
        "roi": "frames are drawn whole; 'lfrender render' draws a part of one",
    },
    inputs="the first frame",
    several="INPUT...",
)
def batch(capture: CaptureInput, given: Any) -> int:
    """Render all frames of a sequence.

    Frames are image files, folders of them, pages of TIFF files, and videos. The camera is calibrated once, depth
    is kept where nothing moves, pictures already there are kept, and a frame that cannot be read is reported and
    does not stop the others (exit code 1).
    """
    from .. import open_frames
    from ..output.formats import check_format
    from ..sequence.frames import is_video

    report, output, film = capture.report, given.output, is_video(given.output)
    further = _film_options(given) if film else _folder_options(given)
    if film:
        check_format(output, "film", inputs=[*given.inputs, *capture.files])
    frames = open_frames(given.inputs, **capture.raw_layout(given.inputs), dark=capture.dark)
    calibration = None
    if capture.camera or capture.white or capture.mosaic:
        with report.stage("calibrate"):
            calibration = _find_camera(frames, capture)
    results, start = [], perf_counter()
    with (
        report.stage("frames"), report.progress("frames") as step, connect_cluster(given, report) as cluster,
    ):  # fmt: skip
        from .. import render_frames
        from ..sequence.film import render_film

        render: Any = render_film if film else render_frames
        for result in render(
            frames=frames, calibration=calibration, preset=capture.preset or "balanced", scale=given.scale,
            overwrite=given.overwrite, **cluster, **further,
        ):  # fmt: skip
            results.append(result)
            step(len(results), frames.count, result.message)
    seconds = perf_counter() - start
    if calibration is None and not film:
        from ..sequence.job import load_camera

        with suppress(CameraFileError):
            calibration = load_camera(output)
    warnings = [] if calibration is None else list(calibration.warnings)
    rendered = [result for result in results if result.outcome == "rendered"]
    failures = [result.message for result in results if result.outcome == "failed"]
    kept, each = len(results) - len(rendered) - len(failures), seconds / max(len(rendered), 1)
    still = sum(result.still for result in rendered) / max(len(rendered), 1)
    told = [f"{len(rendered):,} frames rendered, {each:.2f} s each"]
    told += [f"{kept:,} kept from before"] if kept else []
    told += [f"{len(failures):,} failed"] if failures else []
    report.finish(
        {
            "film" if film else "pictures": str(output), "rendered": len(rendered), "kept": kept,
            "failed": len(failures), "seconds_per_frame": each, "still": still,
            "warnings": [*warnings, *failures] if report.as_json else warnings,
        },
        f"{', '.join(told)}.{f' {percent(still)} of their lenses had not moved.' if still > 0.005 else ''}",
        f"{output} is written.",
    )  # fmt: skip
    return 1 if failures else 0


def _film_options(given: Any) -> dict[str, Any]:
    """The arguments of `render_film`."""
    if given.views is not None:
        raise click.UsageError(f"{given.output} is a film; views go into a folder")
    _check_view_options(given)
    if given.suffix is not None or given.eight_bits:
        raise click.UsageError(f"{given.output} is a film: leave out --format and --8bit")
    return {"path": given.output, "rate": given.fps}


def _folder_options(given: Any) -> dict[str, Any]:
    """The arguments of `render_frames`."""
    from ..sequence.view_grid import ViewGrid

    check_folder(given.output)
    _check_view_options(given)
    suffix = (given.suffix or "tif").lstrip(".")
    raw = suffix.startswith("yuv")
    if given.fps is not None:
        raise click.UsageError("--fps is for films: give -o FILM.mp4 or FILM.mkv")
    if given.eight_bits and raw:
        raise click.UsageError("--8bit is for pictures: leave it out, or --format yuv")
    if raw and given.views is None:
        raise click.UsageError("raw video is a film or views: give -o FILM.yuv, or --views")
    options = {"folder": given.output, "eight_bits": given.eight_bits, "suffix": f".{suffix}"}
    if given.views is None:
        return options
    rows, columns = given.views
    return {**options, "views": ViewGrid(rows, columns, given.aperture or 0.7, given.resize)}


def _check_view_options(given: Any) -> None:
    if given.views is None and (given.aperture is not None or given.resize is not None):
        raise click.UsageError("--aperture and --resize are for --views")


def _find_camera(frames: Frames, capture: CaptureInput) -> Calibration:
    """The camera, with what the first frame that can be read shows of it."""
    for frame in frames:
        with suppress(FlatError):
            pixels = frame.read()
            break
    else:
        raise FlatError("none of the frames can be read")
    return capture.find_camera(pixels)
