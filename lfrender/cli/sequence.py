"""`lfrender batch`: the frames of a sequence, here, on several processes or on a cluster."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import click

from lfcal import CameraFileError
from lfcal.runtime import console
from lfcal.runtime.output_file import check_folder

from .camera_input import read_camera
from .figures import percent
from .inputs import raw_layout
from .options import (
    CAMERA,
    INPUT,
    at_most_one,
    cluster_options,
    connect_cluster,
    eight_bits_option,
    grid_size,
    output_option,
    preset_option,
    scale_option,
    white_option,
)

if TYPE_CHECKING:
    from lfcal import Calibration

    from ..sequence.frames import Frames
    from ..sequence.job import FrameResult

__all__ = ["batch"]


@console.command(
    "lfrender batch frames -o pictures",
    "lfrender batch film.mkv -c camera.json -o pictures --format png",
    "lfrender batch film.mkv -c camera.json -o sharp.mp4",
    "lfrender batch frames/*.png -o pictures --workers 4",
    "lfrender batch film_2048x2048_420p10.yuv -c camera.cfg -o views --views 5x5 --format yuv --resize 1920x1080",
)
@console.several_inputs("inputs", "INPUT...")
@console.grouped(
    "Files",
    output_option("FOLDER|FILM", "Folder for the pictures, or a film: .mp4, or .mkv without any loss."),
    click.option("-c", "--camera", type=INPUT, help=f"{CAMERA} Without it, the first frame is calibrated."),
    white_option,
    click.option("--dark", type=INPUT, help="Dark frame that is subtracted from all frames and the white image."),
    click.option("--overwrite", is_flag=True, help="Render all frames again; else pictures already there are kept."),
)
@console.grouped(
    "What to draw",
    scale_option,
    click.option(
        "--format", "suffix", help="Format of the pictures: tif, jpg, ...; of views also yuv.  [default: tif]"
    ),
    eight_bits_option,
    click.option(
        "--fps",
        type=click.FloatRange(0, 1000, min_open=True),
        help="Pictures a second of a film.  [default: as the input, or 25]",
    ),
    click.option(
        "--views",
        metavar="ROWSxCOLUMNS",
        help="Views of a grid: with --format yuv a file for each, v000-WxH.yuv ..., else FRAME/image_001 ...",
    ),
    click.option(
        "--aperture",
        type=click.FloatRange(0, 1, min_open=True),
        help="Of --views, as in 'lfrender views'.  [default: 0.7]",
    ),
    click.option("--resize", type=console.SizeOption(), help="Size of --views [px]."),
)
@console.grouped("Depth analysis", preset_option)
@console.grouped("Reading INPUT", console.raw_video_options)
@cluster_options
@console.report_options
def batch(
    inputs: tuple[Path, ...],
    output: Path,
    size: tuple[int, int] | None,
    pixel_format: str | None,
    camera: Path | None,
    white: Path | None,
    dark: Path | None,
    scale: float | None,
    suffix: str | None,
    eight_bits: bool,
    views: str | None,
    aperture: float | None,
    resize: tuple[int, int] | None,
    fps: float | None,
    overwrite: bool,
    workers: int | None,
    scheduler: str | None,
    preset: str,
    as_json: bool,
    quiet: bool,
) -> int:
    """Render all frames of a sequence.

    Frames are image files, folders of them, pages of TIFF files, and videos. The camera is calibrated once, depth
    is kept where nothing moves, pictures already there are kept, and a frame that cannot be read is reported and
    does not stop the others (exit code 1).
    """
    from .. import open_frames
    from ..sequence.frames import is_video

    report = console.Report(as_json, quiet)
    at_most_one("--camera", camera, "--white", white)
    at_most_one("--workers", workers, "--scheduler", scheduler)
    options: dict[str, Any] = {"preset": preset, "scale": scale, "overwrite": overwrite}
    if views is None and (aperture is not None or resize is not None):
        raise click.UsageError("--aperture and --resize are for --views")
    if film := is_video(output):
        if views is not None:
            raise click.UsageError(f"{output} is a film; views go into a folder")
        if suffix is not None or eight_bits:
            raise click.UsageError(f"{output} is a film: leave out --format and --8bit")
        from ..sequence.film import check_film

        check_film(output, [*inputs, camera, white, dark])
        options |= {"path": output, "rate": fps}
    else:
        check_folder(output)
        if fps is not None:
            raise click.UsageError("--fps is for films: give -o FILM.mp4 or FILM.mkv")
        if eight_bits and (suffix or "").lstrip(".").startswith("yuv"):
            raise click.UsageError("--8bit is for pictures: leave it out, or --format yuv")
        options |= {"folder": output, "eight_bits": eight_bits, "suffix": f".{(suffix or 'tif').lstrip('.')}"}
        if views is not None:
            from ..sequence.view_grid import ViewGrid

            options["views"] = ViewGrid(*grid_size("--views", views), aperture or 0.7, resize)
        elif (suffix or "").lstrip(".").startswith("yuv"):
            raise click.UsageError("raw video is a film or views: give -o FILM.yuv, or --views")
    frames = open_frames(inputs, **raw_layout(inputs, size, pixel_format, camera), dark=dark)
    calibration = None
    if camera or white:
        with report.stage("calibrate"):
            calibration = _find_camera(frames, camera, white, dark)
    results, start = [], perf_counter()
    with (
        report.stage("frames"),
        report.progress("frames", frames.count) as advance,
        connect_cluster(workers, scheduler, report) as cluster,
    ):
        from .. import render_frames
        from ..sequence.cluster import render_frames_on
        from ..sequence.film import render_film

        render: Any = render_film if film else render_frames_on if cluster else render_frames
        for result in render(frames=frames, calibration=calibration, **cluster, **options):
            results.append(result)
            advance(result.message)
    figures = {"film" if film else "pictures": str(output), **_count(results, perf_counter() - start)}
    failures = [result.message for result in results if result.outcome == "failed"]
    counts = [f"{figures['rendered']:,} frames rendered, {figures['seconds_per_frame']:.2f} s each"]
    counts += [f"{figures['kept']:,} kept from before"] if figures["kept"] else []
    counts += [f"{len(failures):,} failed"] if failures else []
    still = f" {percent(figures['still'])} of their lenses had not moved." if figures["still"] > 0.005 else ""
    if calibration is None and not film:
        from ..sequence.job import load_camera

        with suppress(CameraFileError):
            calibration = load_camera(output)
    doubts = [] if calibration is None else list(calibration.warnings)
    report.finish(
        {**figures, "warnings": [*doubts, *failures] if as_json else doubts},
        f"{', '.join(counts)}.{still}",
        f"{output} is written.",
    )
    return 1 if failures else 0


def _count(results: list[FrameResult], seconds: float) -> dict[str, Any]:
    """How many frames had which outcome, wall time per frame, and mean share of static lenses."""
    rendered = [result for result in results if result.outcome == "rendered"]
    return {
        "rendered": len(rendered),
        "kept": sum(result.outcome == "kept" for result in results),
        "failed": sum(result.outcome == "failed" for result in results),
        "seconds_per_frame": seconds / max(len(rendered), 1),
        "still": sum(result.still for result in rendered) / max(len(rendered), 1),
    }


def _find_camera(frames: Frames, camera: Path | None, white: Path | None, dark: Path | None) -> Calibration:
    """The camera of a white image, or of a file, with what the first frame that can be read shows of it."""
    from lfcal import FlatError, calibrate, read_flat, subtract_dark

    calibration = None
    if white is not None:
        pixels = read_flat(white)
        if dark is not None:
            with console.name_file_in_errors(dark):
                pixels = subtract_dark(pixels, read_flat(dark))
        with console.name_file_in_errors(white):
            calibration = calibrate(pixels, kind="white")
    for frame in frames:
        try:
            pixels = frame.read()
        except FlatError:
            continue
        if calibration is not None:
            return calibration.with_mosaic_of(pixels)
        assert camera is not None
        return read_camera(camera, pixels)
    raise FlatError("none of the frames can be read")
