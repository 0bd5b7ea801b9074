"""`lfrender batch`: the frames of a sequence, here, on several processes or on a cluster."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import click

from lfcal.runtime import console

from .inputs import read_camera
from .options import CAMERA, INPUT, OUTPUT, at_most_one, preset_option

if TYPE_CHECKING:
    from lfcal import Calibration

    from ..sequence.job import FrameResult

__all__ = ["batch"]


@click.command(
    epilog=console.help_examples(
        "lfrender batch frames -o pictures",
        "lfrender batch film.mkv -c camera.json -o pictures --format png",
        "lfrender batch film.mkv -c camera.json -o sharp.mp4",
        "lfrender batch frames/*.png -o pictures --workers 4",
    )
)
@console.several_inputs("inputs", "INPUT...")
@click.option(
    "-o",
    "--output",
    type=OUTPUT,
    required=True,
    metavar="FOLDER|FILM",
    help="Folder for the pictures, or a film: .mp4, or .mkv without any loss.",
)
@click.option("-c", "--camera", type=INPUT, help=CAMERA + " Without it, the first frame is calibrated.")
@click.option("--white", type=INPUT, help="Calibrate from this white image of the same camera.")
@click.option("--scale", type=click.FloatRange(0, min_open=True), help="Output pixels per microlens pitch.")
@click.option("--format", "suffix", help="Kind of the pictures: tif, png, jpg, webp.  [default: tif]")
@click.option(
    "--fps",
    type=click.FloatRange(0, 1000, min_open=True),
    help="Pictures a second of a film.  [default: as the input, or 25]",
)
@click.option("--overwrite", is_flag=True, help="Render all frames anew; else pictures already there are kept.")
@click.option("--workers", type=click.IntRange(1), help="Render on so many processes of this machine (needs Dask).")
@click.option("--scheduler", metavar="tcp://HOST:PORT", help="Render on the workers of this Dask scheduler.")
@preset_option
@console.report_options
def batch(
    inputs: tuple[Path, ...],
    output: Path,
    camera: Path | None,
    white: Path | None,
    scale: float | None,
    suffix: str | None,
    fps: float | None,
    overwrite: bool,
    workers: int | None,
    scheduler: str | None,
    preset: str,
    as_json: bool,
    quiet: bool,
) -> int:
    """Render all frames of a sequence: image files, folders of them, TIFF files of several pages, videos.

    The camera is calibrated once, depth is kept where nothing moves, pictures already there are kept, and a frame that
    cannot be read is reported and does not stop the others (exit code 1).
    """
    from .. import open_frames
    from ..sequence.frames import is_video

    report = console.Report(as_json, quiet)
    at_most_one("--camera", camera, "--white", white)
    at_most_one("--workers", workers, "--scheduler", scheduler)
    options = {"preset": preset, "scale": scale, "overwrite": overwrite}
    if film := is_video(output):
        if suffix is not None:
            raise click.UsageError(f"{output} is a film: leave out --format")
        from ..sequence.film import check_film

        check_film(output, inputs)
        options["rate"] = fps
    else:
        if fps is not None:
            raise click.UsageError("--fps is for films: give -o FILM.mp4 or FILM.mkv")
        options["suffix"] = f".{(suffix or 'tif').lstrip('.')}"
    frames = open_frames(inputs)
    calibration = None
    if camera or white:
        with report.stage("calibrate"):
            calibration = _batch_camera(frames, camera, white)
    report.announce_compilation("lfcal", "lfrender")
    outcomes, start = [], perf_counter()
    with report.stage("frames"), report.progress("frames", frames.count) as advance, ExitStack() as opened:
        for result in _rendered(opened, frames, output, film, calibration, workers, scheduler, options):
            outcomes.append(result)
            advance(result.message)
    rendered = [r for r in outcomes if r.outcome == "rendered"]
    failed = [r for r in outcomes if r.outcome == "failed"]
    figures = {
        "film" if film else "pictures": str(output),
        "rendered": len(rendered),
        "kept": sum(r.outcome == "kept" for r in outcomes),
        "failed": len(failed),
        # Some are worked on at once.
        "seconds_per_frame": (perf_counter() - start) / max(len(rendered), 1),
        "still": sum(r.still for r in rendered) / max(len(rendered), 1),
    }
    report.finish({**figures, "warnings": [r.message for r in failed]} if as_json else figures)
    return 1 if failed else 0


def _rendered(
    opened: ExitStack,
    frames: Any,
    output: Path,
    film: bool,
    calibration: Calibration | None,
    workers: int | None,
    scheduler: str | None,
    options: dict[str, Any],
) -> Iterator[FrameResult]:
    """Results of rendering pictures or a film, here or on a cluster, which is closed along with `opened`."""
    from .. import render_film, render_frames, render_frames_on

    client = None
    if workers is not None or scheduler is not None:
        from ..sequence.cluster import connect

        client = opened.enter_context(connect(workers, scheduler))
    threads = 1 if workers else None
    if film:
        return render_film(frames, output, calibration, client=client, threads=threads, **options)
    if client is None:
        return render_frames(frames, output, calibration, **options)
    return render_frames_on(client, frames, output, calibration, threads=threads, **options)


def _batch_camera(frames: Any, camera: Path | None, white: Path | None) -> Calibration:
    """The camera of a file or white image, checked against the first frame that can be read where it was published."""
    from lfcal import FlatError, calibrate, read_flat

    if white is not None:
        with console.name_file_in_errors(white):
            return calibrate(read_flat(white), kind="white")
    assert camera is not None
    for frame in frames:
        try:
            pixels = frame.read()
        except FlatError:
            continue
        return read_camera(camera, pixels)
    raise FlatError("none of the frames can be read")
