"""`lfrender batch`: the frames of a sequence, here, on several processes or on a cluster."""

from __future__ import annotations

from contextlib import suppress
from time import perf_counter
from typing import TYPE_CHECKING, Any

import click

from lfcal import CameraFileError, FlatError
from lfcal.runtime import command_line as cl
from lfcal.runtime.output_file import check_folder

from ..runtime.types import Entries
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
    "batch",
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
        "What to draw": "scale resize frame_views frame_aperture",
        "How to write it": "frame_format eight_bits exposure tone white_balance quality fps",
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
    if maps in films:
        check_format(maps, "film")
    elif maps is not None:
        check_folder(maps)
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
    found["film" if output in films else "pictures"] = output
    if calibration is None and output not in films:
        from ..sequence.run_folder import load_camera

        with suppress(CameraFileError):
            calibration = load_camera(output)
    failures = [result.message for result in results if result.outcome == "failed"]
    found["warnings"] = list(calibration.warnings) if calibration else []
    if report.as_json:
        found["warnings"] += failures
    sentences = [sentence, f"{output} is written."]
    if maps is not None:
        found |= {"depth_maps": maps, "colours": plan.colours}
        content = "the depth maps"
        if maps in films:
            from ..data.depth_order import describe_scale

            content = describe_scale(plan.colours)
        sentences.append(f"{maps}: {content}.")
    report.finish(found, *sentences, *plan.changes)
    return int(bool(failures))


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
    from ..sequence.film import DEFAULT_RATE, render_film

    report = capture.report
    results = []
    plans = []

    def announce(plan: Plan) -> None:
        plans.append(plan)
        if not (report.quiet or report.as_json):
            cl.echo(_describe(plan, given, rate), err=True)

    render: Any = render_frames
    rate = None
    if given.output in films:
        render = render_film
        rate = given.fps or frames.rate or DEFAULT_RATE
    with (
        report.stage("frames"),
        report.progress("frames") as step,
        connect_cluster(given, report) as cluster,
    ):
        try:
            run = {"overwrite": given.overwrite, "announce": announce, **cluster}
            for result in render(frames, given.output, calibration, options, **run):
                results.append(result)
                step(len(results), frames.count or None, result.message)
        except KeyboardInterrupt:
            if not report.quiet:
                again = "the same command"
                if given.overwrite:
                    again += " without --overwrite"
                counts = f"{len(results):,} of {frames.count:,}"
                cl.echo(f"{counts} frames are done; {again} goes on", err=True)
            raise
    return results, plans[0]


def _describe(plan: Plan, given: Any, rate: Any) -> str:
    """One line about what will be written; `rate` is that of a film."""
    line = f"Writes {plan.frames:,} frames"
    if plan.kept:
        line += f" ({plan.kept:,} kept from before)"
    if given.views:
        line += " in {} x {} views".format(*given.views)
    if plan.size is not None:
        line += " of {} x {} px".format(*plan.size)
    if rate is not None:
        line += f", {float(rate):.4g} a second,"
    line += f" into {given.output}"
    if given.depth_maps is not None:
        line += f", their depth into {given.depth_maps}"
    return f"{line}."


def _sum_up(results: list[FrameResult], seconds: float) -> tuple[Entries, str]:
    """Figures of a run, and a sentence."""
    outcomes = [result.outcome for result in results]
    figures: Entries = {name: outcomes.count(name) for name in ("rendered", "kept", "failed")}
    rendered = figures["rendered"]
    each = seconds / max(rendered, 1)
    # Frames that were not rendered have no still lenses.
    still = sum(result.still for result in results) / max(rendered, 1)
    sentence = f"{rendered:,} frames rendered"
    if rendered:
        sentence += f", {each:.2f} s each"
    for outcome, words in (("kept", "kept from before"), ("failed", "failed")):
        if figures[outcome]:
            sentence += f", {figures[outcome]:,} {words}"
    sentence += "."
    if round(100 * still):
        sentence += f" {percent(still)} of their lenses had not moved."
    return figures | {"seconds_per_frame": each, "still": still}, sentence


def _frame_options(capture: CaptureInput, given: Any, film: bool) -> FrameOptions:
    """The options of `render_frames`, or of `render_film` if the output is a film."""
    from ..output.formats import check_format
    from ..output.raw_video import check_raw_format
    from ..output.views import check_grid
    from ..sequence.options import FrameOptions
    from ..sequence.view_grid import ViewGrid

    output = given.output
    suffix = (given.suffix or "tif").lstrip(".")
    raw = suffix.startswith("yuv")
    if given.views is None and given.aperture is not None:
        raise click.UsageError("--aperture is for --views")
    if film and given.views is not None:
        raise click.UsageError(f"{output} is a film; views go into a folder")
    if film and (given.suffix is not None or given.eight_bits):
        raise click.UsageError(f"{output} is a film: leave out --format and --8bit")
    if raw and given.eight_bits:
        raise click.UsageError("--8bit is for pictures: leave it out, or --format yuv")
    if raw and given.views is None:
        raise click.UsageError("raw video is a film or views: give -o FILM.yuv, or --views")
    if film:
        check_format(output, "film", quality=given.quality)
    elif raw:
        check_raw_format(check_folder(output), suffix, given.quality)
    else:
        check_grid(output, f".{suffix}", quality=given.quality)
    views = given.views
    if views is not None:
        rows, columns = views
        views = ViewGrid(rows, columns, given.aperture or ViewGrid.aperture)
    names = "scale eight_bits exposure tone white_balance quality depth_maps"
    return FrameOptions(
        preset=capture.chosen_preset,
        suffix=f".{suffix}",
        size=given.resize,
        views=views,
        rate=given.fps,
        **{name: getattr(given, name) for name in names.split()},
    )


def _find_camera(frames: Frames, capture: CaptureInput) -> Calibration:
    """The camera, checked on the first frame that can be read and is no even grey."""
    from ..sequence.frames import read_lit

    for frame in frames:
        with suppress(FlatError):
            pixels = read_lit(frame)
            break
    else:
        raise FlatError("none of the frames can be read, or all are dark or saturated")
    return capture.find_camera(pixels)
