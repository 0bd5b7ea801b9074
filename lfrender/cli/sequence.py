"""`lfrender batch`: the frames of a sequence, here, on several processes or on a cluster."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING, Any

import click

from lfcal import CameraFileError, FlatError
from lfcal.runtime import command_line as cl
from lfcal.runtime.output_file import check_folder

from .figures import percent
from .inputs import CaptureInput
from .options import capture_command, connect_cluster, option_errors

if TYPE_CHECKING:
    from pathlib import Path

    from lfcal import Calibration

    from ..sequence.film import Plan
    from ..sequence.frames import Frames
    from ..sequence.options import FrameOptions
    from ..sequence.run import FrameResult

__all__ = ["batch"]


@capture_command(
    "lfrender batch frames -o pictures",
    "lfrender batch film.mkv -c camera.json -o pictures --format png",
    "lfrender batch film.mkv -c camera.json -o sharp.mp4 --depth-maps depth.mp4",
    "lfrender batch film.mkv -c camera.json -o sharp.mov --start 2.5 --end 10",
    "lfrender batch frames/*.png -o pictures --workers 4",
    "lfrender batch film_2048x2048_420p10.yuv -c camera.cfg -o views --views 5x5 --format yuv "
    "--resize 1920x1080",
    output=(
        "FOLDER|FILM",
        "Folder for the pictures, or a film: .mp4, .mov for cutting, or .mkv without any loss.",
    ),
    own={
        "Files": "depth_maps overwrite",
        "Which frames": "frames start end",
        "What to draw": "scale frame_format eight_bits exposure fps "
        "frame_views frame_aperture resize",
        "Several processes": "workers scheduler",
    },
    refused={
        "depth_file": "the depth of every frame is analysed; --depth-maps writes it",
        "page": "several frames are rendered; --frames chooses which",
        "roi": "frames are drawn whole; 'lfrender render' draws a part of one",
    },
    inputs="the first frame",
    several="INPUT...",
)
def batch(capture: CaptureInput, given: Any) -> int:
    """Render the frames of a sequence.

    Frames are image files, folders of them, pages of TIFF files, and videos. The camera is
    calibrated once, depth is kept where nothing moves, pictures already there are kept, and a frame
    that cannot be read is reported and does not stop the others (exit code 1).
    """
    from ..output.formats import check_format
    from ..sequence.frames import is_video

    report = capture.report
    output = given.output
    maps = given.depth_maps
    films = [path for path in (output, maps) if path is not None and is_video(path)]
    options = _frame_options(capture, given, output in films)
    if given.fps is not None and not films:
        raise click.UsageError("--fps is for films: give -o FILM.mp4 or FILM.mkv")
    if films == [output, output]:
        raise click.UsageError(f"--depth-maps must be another file than {output}")
    for path in films:
        check_format(path, "film", inputs=[*given.inputs, *capture.files])
    chosen = {name: getattr(given, name) for name in ("frames", "start", "end")}
    with option_errors():
        frames = capture.open_frames(given.inputs, **chosen)
    calibration = None
    if capture.camera or capture.white or capture.mosaic or capture.recording:
        with report.stage("calibrate"):
            calibration = _find_camera(frames, capture)
    start = perf_counter()
    results, plan = _render(capture, given, frames, calibration, films, options)
    found, sentence = _sum_up(results, perf_counter() - start)
    if calibration is None and output not in films:
        from ..sequence.run_folder import load_camera

        with suppress(CameraFileError):
            calibration = load_camera(output)
    found = {"film" if output in films else "pictures": str(output), **found}
    failures = [result.message for result in results if result.outcome == "failed"]
    found["warnings"] = [
        *(calibration.warnings if calibration else ()),
        *(failures if report.as_json else ()),
    ]
    sentences = [sentence, f"{output} is written."]
    if maps is not None:
        found |= {"depth_maps": str(maps), "colours": plan.colours}
        ends = "magnification M from {:.1f} (blue) to {:.1f} (red), logarithmic".format(
            *plan.colours or (0, 0)
        )
        sentences.append(f"{maps}: {ends}." if maps in films else f"{maps}: the depth maps.")
    report.finish(found, *sentences)
    return 1 if failures else 0


def _render(
    capture: CaptureInput,
    given: Any,
    frames: Frames,
    calibration: Calibration | None,
    films: list[Path],
    options: FrameOptions,
) -> tuple[list[FrameResult], Plan]:
    """Render all frames; print the plan before, and show the progress."""
    from .. import render_frames
    from ..sequence.film import render_film

    report = capture.report
    results = []
    plans = []

    def announce(plan: Plan) -> None:
        plans.append(plan)
        if not (report.quiet or report.as_json):
            rate = None if given.output not in films else given.fps or frames.rate or 25
            cl.echo(_describe(plan, given, rate), err=True)

    render: Any = render_film if given.output in films else render_frames
    with (
        report.stage("frames"),
        report.progress("frames") as step,
        connect_cluster(given, report) as cluster,
    ):
        try:
            for result in render(
                frames,
                given.output,
                calibration,
                options,
                overwrite=given.overwrite,
                announce=announce,
                **cluster,
            ):
                results.append(result)
                step(len(results), frames.count or None, result.message)
        except KeyboardInterrupt:
            if not report.quiet:
                again = (
                    "the same command without --overwrite"
                    if given.overwrite
                    else "the same command"
                )
                cl.echo(
                    f"{len(results):,} of {frames.count:,} frames are done; {again} goes on",
                    err=True,
                )
            raise
    return results, plans[0]


def _describe(plan: Plan, given: Any, rate: Any) -> str:
    """One line about what will be written; `rate` is that of a film."""
    size = "" if plan.size is None else " of {} x {} px".format(*plan.size)
    speed = "" if rate is None else f", {float(rate):.4g} a second,"
    kept = f" ({plan.kept:,} kept from before)" if plan.kept else ""
    views = " in {} x {} views".format(*given.views) if given.views else ""
    maps = "" if given.depth_maps is None else f", their depth into {given.depth_maps}"
    return f"Writes {plan.frames:,} frames{kept}{views}{size}{speed} into {given.output}{maps}."


def _sum_up(results: list[FrameResult], seconds: float) -> tuple[dict[str, Any], str]:
    """Figures of a run, and a sentence."""
    rendered = [result for result in results if result.outcome == "rendered"]
    kept, failed = (
        sum(result.outcome == name for result in results) for name in ("kept", "failed")
    )
    each = seconds / max(len(rendered), 1)
    still = sum(result.still for result in rendered) / max(len(rendered), 1)
    told = [f"{len(rendered):,} frames rendered" + (f", {each:.2f} s each" if rendered else "")]
    told += [f"{kept:,} kept from before"] if kept else []
    told += [f"{failed:,} failed"] if failed else []
    figures = {
        "rendered": len(rendered),
        "kept": kept,
        "failed": failed,
        "seconds_per_frame": each,
        "still": still,
    }
    moved = f" {percent(still)} of their lenses had not moved." if still > 0.005 else ""
    return figures, f"{', '.join(told)}.{moved}"


def _frame_options(capture: CaptureInput, given: Any, film: bool) -> FrameOptions:
    """The options of `render_frames`, or of `render_film` if the output is a film."""
    from ..sequence.options import FrameOptions
    from ..sequence.view_grid import ViewGrid

    options = FrameOptions(
        preset=capture.chosen_preset,
        scale=given.scale,
        exposure=given.exposure,
        depth_maps=given.depth_maps,
        rate=given.fps,
    )

    if given.views is None and (given.aperture is not None or given.resize is not None):
        raise click.UsageError("--aperture and --resize are for --views")
    if film:
        if given.views is not None:
            raise click.UsageError(f"{given.output} is a film; views go into a folder")
        if given.suffix is not None or given.eight_bits:
            raise click.UsageError(f"{given.output} is a film: leave out --format and --8bit")
        return options
    check_folder(given.output)
    suffix = (given.suffix or "tif").lstrip(".")
    if suffix.startswith("yuv") and given.eight_bits:
        raise click.UsageError("--8bit is for pictures: leave it out, or --format yuv")
    if suffix.startswith("yuv") and given.views is None:
        raise click.UsageError("raw video is a film or views: give -o FILM.yuv, or --views")
    rows, columns = given.views or (0, 0)
    grid = ViewGrid(rows, columns, given.aperture or 0.7, given.resize) if given.views else None
    return replace(options, eight_bits=given.eight_bits, suffix=f".{suffix}", views=grid)


def _find_camera(frames: Frames, capture: CaptureInput) -> Calibration:
    """The camera, checked on the first frame that can be read."""
    for frame in frames:
        with suppress(FlatError):
            pixels = frame.read()
            break
    else:
        raise FlatError("none of the frames can be read")
    return capture.find_camera(pixels)
