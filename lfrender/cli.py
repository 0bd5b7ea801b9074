"""Command line of lfrender: analyse depth, render pictures, show what the toolkit does."""

from __future__ import annotations

import gc
import sys
from contextlib import ExitStack, suppress
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

import click

from lfcal import LightFieldError, check_output, console

from .embedded import read_embedded
from .page_commands import report, view
from .picture import check_picture, write_picture

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Literal

    import numpy as np
    from numpy.typing import NDArray

    from lfcal import Calibration

    from .depthmap import DepthMap
    from .frame_job import FrameResult
    from .optics import Optics
    from .rendering import Rendering

    Mosaic = Literal["RGGB", "BGGR", "GRBG", "GBRG"]

__all__ = ["main"]

_PATH = click.Path(path_type=Path)
_CAMERA = "Camera file of lfcal, or a published calibration (.xml, .cfg)."


def _preset(command: Any) -> Any:
    return click.option(
        "--preset",
        type=click.Choice(["fast", "balanced", "accurate"]),
        default="balanced",
        show_default=True,
        help="How much time the depth analysis may take.",
    )(command)


def _cluster(command: Any) -> Any:
    command = click.option("--scheduler", metavar="tcp://HOST:PORT", help="Work on tiles on this Dask scheduler.")(
        command
    )
    return click.option("--workers", type=click.IntRange(1), help="Work on tiles in so many processes (needs Dask).")(
        command
    )


@click.group(cls=console.Program, name="lfrender", context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="lfrender", prog_name="lfrender")
def main() -> None:
    """Depth and full-resolution pictures from focused plenoptic captures."""


main.add_command(report)
main.add_command(view)


@main.command(
    epilog=console.examples(
        "lfrender analyze flat.png -c camera.json -o depth.npz",
        "lfrender analyze flat.png -c camera.json -o depth.npz --dense depth.tif --picture depth.png",
        "lfrender analyze flat.png -c camera.json -o depth.npz --roi 400 300 900 700",
    )
)
@click.argument("flat", type=_PATH)
@click.option("-c", "--camera", type=_PATH, required=True, help=_CAMERA)
@click.option("-o", "--output", type=_PATH, required=True, metavar="DEPTH.npz", help="Depth map to write.")
@click.option("--dense", type=_PATH, metavar="DEPTH.tif|.pfm", help="Patch size [px] of every pixel of the picture.")
@click.option("--picture", type=_PATH, metavar="DEPTH.png", help="Magnification M in colours, with its legend.")
@click.option("--ply", type=_PATH, metavar="CLOUD.ply", help="Point cloud: X/D, Y/D, virtual depth D/s, colour.")
@click.option(
    "--optics",
    "optics_file",
    type=_PATH,
    metavar="OPTICS.json",
    help="Focal length and distances [mm] of the camera: distances in metres, the point cloud too.",
)
@click.option("--roi", type=float, nargs=4, metavar="X0 Y0 X1 Y1", help="Only lenses with their centre in here [px].")
@click.option("--exhaustive", is_flag=True, help="Take no shortcuts: match every lens at every shift.")
@_cluster
@_preset
@console.report_options
def analyze(
    flat: Path,
    camera: Path,
    output: Path,
    dense: Path | None,
    picture: Path | None,
    ply: Path | None,
    optics_file: Path | None,
    roi: tuple[float, float, float, float] | None,
    exhaustive: bool,
    workers: int | None,
    scheduler: str | None,
    preset: str,
    as_json: bool,
    quiet: bool,
) -> None:
    """Find for every microlens of FLAT its patch size and whether it is telescopic or binocular."""
    report = console.Report(as_json, quiet)
    check_output(output, {".npz"}, [flat, camera])
    for path, endings in ((dense, {".tif", ".tiff", ".pfm"}), (picture, {".png"}), (ply, {".ply"})):
        if path is not None:
            check_output(path, endings, [flat, camera])
    _at_most_one("--workers", workers, "--scheduler", scheduler)
    cluster = workers or scheduler
    _at_most_one("--workers or --scheduler", cluster, "--roi", roi, "--ply", ply)
    if roi is None and ply is None:
        from . import large_cli

        if cluster or large_cli.is_large(flat):
            optics = _read_optics(optics_file)
            depth, calibration = large_cli.analyze(
                report, flat, camera, output, preset, not exhaustive, large_cli.Cluster(workers, scheduler)
            )
            with report.stage("write"):
                _write_depth(depth, None, calibration, dense, picture, None, optics)
            figures = {**_camera_figures(calibration), **_depth_figures(depth), **_distance_figures(depth, optics)}
            report.finish({"depth": str(output), **figures})
            return
    with report.stage("read"):
        from lfcal import read_flat

        optics = _read_optics(optics_file)
        pixels = read_flat(flat)
    with report.stage("calibrate"):
        calibration = _read_camera(camera, pixels)
    with report.stage("analyze"):
        try:
            depth = _analyze(report, pixels, calibration, preset, skip=not exhaustive, roi=roi)
        except LightFieldError:
            raise
        except ValueError as error:
            if roi is None:
                raise
            raise click.UsageError(str(error)) from error
    with report.stage("write"):
        depth.save(output)
        _write_depth(depth, pixels, calibration, dense, picture, ply, optics)
    figures = {**_camera_figures(calibration), **_depth_figures(depth), **_distance_figures(depth, optics)}
    report.finish({"depth": str(output), **figures})


@main.command(
    epilog=console.examples(
        "lfrender render flat.png -o picture.tif",
        "lfrender render flat.png -c camera.json --depth depth.npz --scale 12 -o picture.png",
        "lfrender render flat.png --white white.png --patch-size -8.5 -o binocular.png",
    )
)
@click.argument("flat", type=_PATH)
@click.option("-o", "--output", type=_PATH, required=True, metavar="PICTURE", help="Picture to write: .tif, .png, ...")
@click.option("-c", "--camera", type=_PATH, help=_CAMERA + " Without it, the camera is calibrated from FLAT.")
@click.option("--white", type=_PATH, help="Calibrate from this white image of the same camera.")
@click.option("--depth", "depth_file", type=_PATH, help="Depth map made by 'lfrender analyze'.")
@click.option(
    "--patch-size", type=float, help="One signed patch size [px] for all lenses: > 0 telescopic, < 0 binocular."
)
@click.option("--blend", is_flag=True, help="With --patch-size: the mean over lenses instead of the nearest one.")
@click.option("--traditional", is_flag=True, help="One pixel per microlens, the mean of its microimage.")
@click.option("--scale", type=click.FloatRange(0, min_open=True), help="Output pixels per microlens pitch.")
@click.option(
    "--sharpen",
    metavar="auto|PX",
    help="Take back the blur of the microlenses, as far as noise allows: as measured, or of so many output pixels.",
)
@click.option(
    "--mosaic",
    type=click.Choice(["RGGB", "BGGR", "GRBG", "GBRG"]),
    help="Colour filters of the top left 2 x 2 pixels of a raw mosaic, where the camera file does not say.",
)
@click.option("--alpha", is_flag=True, help="Make pixels that no lens has seen transparent (not in JPEG).")
@click.option("--compress", is_flag=True, help="Write a TIFF in deflated tiles: smaller and slower.")
@click.option(
    "--tile",
    type=click.IntRange(16),
    metavar="PIXELS",
    help="Draw in tiles of this side, with little memory, going on where a killed run stopped. [default: large flats]",
)
@click.option("--roi", type=float, nargs=4, metavar="X0 Y0 X1 Y1", help="Draw only this part [px of the flat].")
@_cluster
@_preset
@console.report_options
def render(
    flat: Path,
    output: Path,
    camera: Path | None,
    white: Path | None,
    depth_file: Path | None,
    patch_size: float | None,
    blend: bool,
    traditional: bool,
    scale: float | None,
    sharpen: str | None,
    mosaic: Mosaic | None,
    alpha: bool,
    compress: bool,
    tile: int | None,
    roi: tuple[float, float, float, float] | None,
    workers: int | None,
    scheduler: str | None,
    preset: str,
    as_json: bool,
    quiet: bool,
) -> None:
    """Render FLAT as one picture that is sharp wherever any mode of the camera is.

    Without --depth, --patch-size and --traditional the depth is analysed first. A flat of more than 100 MB, as TIFF or
    Zarr, is read and drawn in tiles; started again, a run that was killed goes on from those that were finished.
    """
    report = console.Report(as_json, quiet)
    _at_most_one("--depth", depth_file, "--patch-size", patch_size, "--traditional", traditional or None)
    _at_most_one("--camera", camera, "--white", white)
    _at_most_one("--scale", scale, "--traditional", traditional or None)
    _at_most_one("--sharpen", sharpen, "--traditional", traditional or None)
    _at_most_one("--roi", roi, "--sharpen", sharpen, "--traditional", traditional or None, "--tile", tile)
    _at_most_one("--workers", workers, "--scheduler", scheduler)
    _at_most_one("--workers or --scheduler", workers or scheduler, "--roi", roi, "--sharpen", sharpen)
    _at_most_one("--workers or --scheduler", workers or scheduler, "--traditional", traditional or None)
    width = _sharpen_width(sharpen)
    if blend and patch_size is None:
        raise click.UsageError("--blend needs --patch-size")
    if not traditional:
        from . import large_cli

        cluster = large_cli.Cluster(workers, scheduler)
        # What is given back to a picture is found on all of it.
        if roi is None and sharpen is None and large_cli.wanted(flat, output, tile, cluster):
            asked = large_cli.Asked(
                flat, output, camera, white, depth_file, patch_size, scale, blend or None, mosaic, alpha, compress,
                tile, preset, cluster,
            )  # fmt: skip
            large_cli.render(report, asked)
            return
    check_picture(output, alpha=alpha, inputs=[flat, camera, white, depth_file])
    _import_meanwhile(output)
    with report.stage("read"):
        from lfcal import read_flat

        pixels = read_flat(flat)
        check_picture(output, pixels.dtype, alpha)
    with report.stage("calibrate"):
        calibration = _camera_of(report, flat, pixels, camera, white, mosaic)
        pixels = _in_colour(pixels, calibration)
    depth = None
    if not traditional and patch_size is None:
        with report.stage("analyze"):
            if depth_file:
                depth = _read_depth(depth_file)
            else:
                from .drawing import lenses_for

                needed = lenses_for(roi, calibration) if roi else None
                depth = _analyze(report, pixels, calibration, preset, roi=needed)
    options = {"patch_size": patch_size, "scale": scale, "blend": blend or None, "sharpen": width, "roi": roi}
    with report.stage("render"):
        picture = _render(report, pixels, calibration, depth, traditional, options)
    with report.stage("write"):
        write_picture(
            output, picture, alpha=alpha, settings=_settings(depth, patch_size, width), embedded=read_embedded(flat),
            compress=compress,
        )  # fmt: skip
    figures = {**_camera_figures(calibration), **(_depth_figures(depth) if depth else {})}
    report.finish({"picture": str(output), **_picture_figures(picture), **figures})


@main.command(epilog=console.examples("lfrender refocus flat.png --at 700 420 -o picture.tif"))
@click.argument("flat", type=_PATH)
@click.option("-o", "--output", type=_PATH, required=True, metavar="PICTURE", help="Picture to write: .tif, .png, ...")
@click.option("-c", "--camera", type=_PATH, help=_CAMERA + " Without it, the camera is calibrated from FLAT.")
@click.option(
    "--patch-size",
    "patch_sizes",
    type=float,
    multiple=True,
    help="Signed patch size [px] in focus: > 0 telescopic, < 0 binocular. Several times: a focal stack.",
)
@click.option("--at", type=float, nargs=2, metavar="X Y", help="Focus on this place [px of the flat] instead.")
@click.option("--stack", type=click.IntRange(1), metavar="N", help="N pictures from the farthest depth to the nearest.")
@click.option("--depth", "depth_file", type=_PATH, help="Depth map by 'lfrender analyze', for --at and --stack.")
@click.option("--aperture", type=float, default=1.0, show_default=True, help="Part of the aperture used, 0.05 to 1.")
@click.option("--scale", type=click.FloatRange(0, min_open=True), help="Output pixels per microlens pitch.")
@console.report_options
def refocus(
    flat: Path,
    output: Path,
    camera: Path | None,
    patch_sizes: tuple[float, ...],
    at: tuple[float, float] | None,
    stack: int | None,
    depth_file: Path | None,
    aperture: float,
    scale: float | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Render FLAT in focus at one depth, out of focus before and behind it.

    Several depths make a focal stack on one grid: pages of one TIFF, or PICTURE_01.png and so on.

    \b
    Examples:
      lfrender refocus flat.png -c camera.json -o near.tif --at 812 455
      lfrender refocus flat.png -c camera.json -o stack.tif --stack 12
    """
    report = console.Report(as_json, quiet)
    _at_most_one("--patch-size", patch_sizes or None, "--at", at, "--stack", stack)
    if not (patch_sizes or at or stack):
        raise click.UsageError("give one of --patch-size, --at and --stack: the depth in focus")
    check_picture(output, inputs=[flat, camera, depth_file])
    with report.stage("read"):
        from lfcal import read_flat

        pixels = read_flat(flat)
        check_picture(output, pixels.dtype)
    with report.stage("calibrate"):
        calibration = _camera_of(report, flat, pixels, camera, None, None)
        pixels = _in_colour(pixels, calibration)
    depth = None
    if at or stack:
        with report.stage("analyze"):
            depth = _read_depth(depth_file) if depth_file else _analyze(report, pixels, calibration, "balanced")
    with report.stage("render"):
        from . import focal_stack, stack_depths
        from . import refocus as run

        report.announce_compilation("lfrender")
        try:
            sizes = stack_depths(depth, stack) if depth is not None and stack else list(patch_sizes)
            if len(sizes) > 1:
                pictures = focal_stack(pixels, calibration, sizes, aperture=aperture, scale=scale)
            else:
                one = sizes[0] if sizes else None
                pictures = [run(pixels, calibration, one, position=at, depth=depth, aperture=aperture, scale=scale)]
        except LightFieldError:
            raise
        except ValueError as error:
            raise click.UsageError(str(error)) from error
    with report.stage("write"):
        settings = [{"rendering": "refocused", "patch_size": size, "at": at} for size in (sizes or (None,))]
        if len(pictures) > 1:
            from . import write_stack

            paths = write_stack(output, pictures, settings=settings, embedded=read_embedded(flat))
        else:
            write_picture(output, pictures[0], settings=settings[0], embedded=read_embedded(flat))
            paths = [output]
    written = {"picture": str(output)} if len(paths) == 1 else {"pictures": [str(path) for path in paths]}
    figures = {**_picture_figures(pictures[0]), **_camera_figures(calibration)}
    report.finish({**written, "patch_sizes": sizes, **figures})


@main.command(
    epilog=console.examples(
        "lfrender views flat.png -o views --grid 5x5",
        "lfrender views flat.png -o pair.png --stereo",
        "lfrender views flat.png -o round.gif --animation 24",
    )
)
@click.argument("flat", type=_PATH)
@click.option("-o", "--output", type=_PATH, required=True, metavar="FOLDER|FILE", help="Folder of a grid, or one file.")
@click.option("-c", "--camera", type=_PATH, help=_CAMERA + " Without it, the camera is calibrated from FLAT.")
@click.option("--depth", "depth_file", type=_PATH, help="Depth map made by 'lfrender analyze'.")
@click.option(
    "--grid", metavar="ROWSxCOLUMNS", help="Pictures on a grid of viewpoints, row1_column1 ... [default: 5x5]"
)
@click.option("--stereo", is_flag=True, help="One picture: the view of the left eye, beside it that of the right one.")
@click.option("--animation", type=click.IntRange(2), metavar="N", help="N views around a circle: .gif, .png or .webp.")
@click.option(
    "--aperture",
    type=click.FloatRange(0, 1, min_open=True),
    default=0.7,
    show_default=True,
    help="How far from the middle, as a part of the radius of the microimages: more parallax, less light.",
)
@click.option("--scale", type=click.FloatRange(0, min_open=True), help="Output pixels per microlens pitch.")
@click.option("--format", "suffix", default="tif", show_default=True, help="Kind of the grid's pictures: tif, png, ...")
@_preset
@console.report_options
def views(
    flat: Path,
    output: Path,
    camera: Path | None,
    depth_file: Path | None,
    grid: str | None,
    stereo: bool,
    animation: int | None,
    aperture: float,
    scale: float | None,
    suffix: str,
    preset: str,
    as_json: bool,
    quiet: bool,
) -> None:
    """Render FLAT sharp at every depth as seen from other places in the main lens: parallax.

    \b
    Examples:
      lfrender views flat.png -c camera.json -o views --grid 5x5
      lfrender views flat.png -c camera.json -o pair.png --stereo
      lfrender views flat.png -c camera.json -o parallax.gif --animation 24
    """
    report = console.Report(as_json, quiet)
    _at_most_one("--grid", grid, "--stereo", stereo or None, "--animation", animation)
    from . import circle_offsets, grid_offsets, stereo_pair, write_animation, write_grid
    from . import views as run

    rows, columns = _grid_size(grid or "5x5")
    suffix = f".{suffix.lstrip('.').lower()}"
    inputs = [flat, camera, depth_file]
    _check_views(output, animation, stereo, suffix, inputs=inputs)
    with report.stage("read"):
        from lfcal import read_flat

        pixels = read_flat(flat)
        _check_views(output, animation, stereo, suffix, pixels.dtype)
    with report.stage("calibrate"):
        calibration = _camera_of(report, flat, pixels, camera, None, None)
        pixels = _in_colour(pixels, calibration)
    with report.stage("analyze"):
        depth = _read_depth(depth_file) if depth_file else _analyze(report, pixels, calibration, preset)
    radius = aperture * calibration.lattice.radius
    with report.stage("render and write"):
        offsets = circle_offsets(animation, radius) if animation else grid_offsets(rows, columns, radius)
        if stereo:
            offsets = [(-radius, 0.0), (radius, 0.0)]
        try:
            pictures = run(pixels, calibration, depth, offsets=offsets, scale=scale)
        except LightFieldError:
            raise
        except ValueError as error:
            raise click.UsageError(str(error)) from error
        settings = {"rendering": "views", "aperture": aperture, "preset": depth.preset}
        if animation:
            write_animation(output, pictures)
        elif stereo:
            write_picture(output, stereo_pair(*pictures), settings=settings, embedded=read_embedded(flat))
        else:
            write_grid(output, pictures, columns, suffix, settings=settings, embedded=read_embedded(flat))
    report.finish({"views": str(output), "offsets": offsets, **_camera_figures(calibration), **_depth_figures(depth)})


def _check_views(
    output: Path, animation: int | None, stereo: bool, suffix: str, dtype: Any = None, inputs: Any = ()
) -> None:
    from .view_files import check_animation, check_grid

    if animation:
        check_animation(output, dtype, inputs)
    elif stereo:
        check_picture(output, dtype, inputs=inputs)
    else:
        check_grid(output, suffix, dtype, inputs)


def _grid_size(text: str) -> tuple[int, int]:
    rows, cross, columns = text.lower().partition("x")
    if not (cross and rows.isdecimal() and columns.isdecimal() and int(rows) and int(columns)):
        raise click.UsageError(f"--grid must be ROWSxCOLUMNS such as 5x5, got {text!r}")
    return int(rows), int(columns)


@main.command(epilog=console.examples("lfrender demo -o demo"))
@click.option(
    "-o", "--output", type=_PATH, default=Path("lfrender-demo"), show_default=True, help="Folder for pictures and page."
)
@console.report_options
def demo(output: Path, as_json: bool, quiet: bool) -> None:
    """Simulate a capture, run the whole chain on it, and show pictures and figures on an HTML page."""
    from .demo import run_demo

    report = console.Report(as_json, quiet, log_stages=True)
    report.finish(run_demo(output, report))


@main.command(
    epilog=console.examples(
        "lfrender batch frames -o pictures",
        "lfrender batch film.mkv -c camera.json -o pictures --format png",
        "lfrender batch film.mkv -c camera.json -o sharp.mp4",
        "lfrender batch frames/*.png -o pictures --workers 4",
    )
)
@click.argument("inputs", type=_PATH, nargs=-1, required=True, metavar="INPUT...")
@click.option(
    "-o",
    "--output",
    type=_PATH,
    required=True,
    metavar="FOLDER|FILM",
    help="Folder for the pictures, or a film: .mp4, or .mkv without any loss.",
)
@click.option("-c", "--camera", type=_PATH, help=_CAMERA + " Without it, the first frame is calibrated.")
@click.option("--white", type=_PATH, help="Calibrate from this white image of the same camera.")
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
@_preset
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

    \b
    Examples:
      lfrender batch frames/ -o pictures
      lfrender batch scene.mp4 -c camera.json -o pictures --preset fast --format png
      lfrender batch scene.mp4 -c camera.json -o sharp.mp4
    """
    from . import open_frames
    from .frames import is_film

    report = console.Report(as_json, quiet)
    _at_most_one("--camera", camera, "--white", white)
    _at_most_one("--workers", workers, "--scheduler", scheduler)
    options = {"preset": preset, "scale": scale, "overwrite": overwrite}
    if film := is_film(output):
        if suffix is not None:
            raise click.UsageError(f"{output} is a film: leave out --format")
        from .film_file import check_film

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
    outcomes = []
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
        "seconds_per_frame": sum(r.seconds for r in rendered) / max(len(rendered), 1),
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
    from . import render_film, render_frames, render_frames_on

    client = None
    if workers is not None or scheduler is not None:
        from .cluster import connect

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
        with console.about(white):
            return calibrate(read_flat(white), kind="white")
    assert camera is not None
    for frame in frames:
        try:
            pixels = frame.read()
        except FlatError:
            continue
        return _read_camera(camera, pixels)
    raise FlatError("none of the frames can be read")


def _import_meanwhile(output: Path) -> None:
    """Import what will be needed while the flat is being decoded, which leaves the interpreter idle."""
    # What is imported stays: collecting garbage among it takes a tenth of the time.
    gc.disable()
    Thread(target=_import_drawing, args=(output.suffix.lower() in (".tif", ".tiff"),)).start()


def _import_drawing(tiff: bool) -> None:
    # The compiler looks for the linear algebra of SciPy, which takes longer to import than the compiler itself. No
    # kernel of ours uses it, and this process runs no others.
    blas = "scipy.linalg.cython_blas"
    absent = blas not in sys.modules
    if absent:
        sys.modules[blas] = None  # type: ignore[assignment]
    try:
        import_module("numba.np.arraymath")
    finally:
        if absent:
            sys.modules.pop(blas, None)
        gc.freeze()
        gc.enable()
    # A command that fails at once ends while this goes on: nothing will be drawn, and nobody minds.
    with suppress(RuntimeError):
        import_module(f"{__package__}.drawing")
        if tiff:
            import_module("tifffile")


def _read_camera(path: Path, pixels: NDArray[np.generic]) -> Calibration:
    """A camera file for flats of this size, in our form or as published."""
    from lfcal import CameraFileError, load

    size = (pixels.shape[1], pixels.shape[0])
    if path.suffix.lower() in (".xml", ".cfg"):
        from lfcal import read_published

        return _checked(read_published(path, size), pixels)
    calibration = load(path)
    if calibration.image_size != size:
        was, now = ("{} x {}".format(*pair) for pair in (calibration.image_size, size))
        raise CameraFileError(f"{path}: made for images of {was} px, this one has {now}; calibrate again")
    return calibration


def _checked(calibration: Calibration, pixels: NDArray[np.generic]) -> Calibration:
    """A published calibration, with a warning where the pixels contradict it."""
    from dataclasses import replace

    from lfcal import agreement

    misfit = agreement(calibration, pixels).warning
    if misfit is None:
        return calibration
    warning = f"as published, {misfit}; calibrate on this flat instead: leave out -c"
    return replace(calibration, warnings=(*calibration.warnings, warning))


def _camera_of(
    report: Any, flat: Path, pixels: NDArray[np.generic], camera: Path | None, white: Path | None, mosaic: Mosaic | None
) -> Calibration:
    if mosaic is not None and pixels.ndim == 3:
        raise click.UsageError(f"{flat} is in colour already; leave out --mosaic")
    if camera:
        from dataclasses import replace

        calibration = _read_camera(camera, pixels)
        return replace(calibration, mosaic=mosaic) if mosaic is not None else calibration
    from lfcal import FlatError, calibrate, read_flat

    if white is None:
        report.announce_compilation("lfcal")
        with console.about(flat):
            return calibrate(pixels, mosaic=mosaic)
    white_pixels = read_flat(white)
    if white_pixels.shape[:2] != pixels.shape[:2]:
        sizes = " and ".join(f"{image.shape[1]} x {image.shape[0]}" for image in (white_pixels, pixels))
        raise FlatError(f"{white}: white image and flat must be of one size, they have {sizes} px")
    report.announce_compilation("lfcal")
    with console.about(white):
        return calibrate(white_pixels, kind="white", mosaic=mosaic if white_pixels.ndim == 2 else None)


def _in_colour(pixels: NDArray[Any], calibration: Calibration) -> NDArray[Any]:
    """The flat without its colour mosaic, once for depth and picture."""
    if calibration.mosaic is None or pixels.ndim == 3:
        return pixels
    from . import demosaic

    return demosaic(pixels, calibration)


def _read_depth(path: Path) -> DepthMap:
    from .depthmap import DepthMap

    return DepthMap.load(path)


def _read_optics(path: Path | None) -> Optics | None:
    if path is None:
        return None
    from .optics import Optics

    return Optics.load(path)


def _write_depth(
    depth: DepthMap,
    pixels: NDArray[np.generic] | None,
    calibration: Calibration,
    dense: Path | None,
    picture: Path | None,
    ply: Path | None,
    optics: Optics | None,
) -> None:
    """The further forms of a depth map that were asked for."""
    if dense:
        from .dense import dense_depth, write_dense

        write_dense(dense, dense_depth(depth))
    if picture:
        from .depth_picture import depth_picture

        write_picture(picture, depth_picture(depth, calibration.lattice))
    if ply and pixels is not None:
        from .point_cloud import point_cloud, write_points

        write_points(ply, point_cloud(pixels, calibration, depth, optics), metres=optics is not None)


def _analyze(
    report: Any, pixels: NDArray[np.generic], calibration: Calibration, preset: str, **options: Any
) -> DepthMap:
    from . import analyze as run

    report.announce_compilation("lfrender")
    return run(pixels, calibration, preset=preset, **options)


def _render(
    report: Any,
    pixels: NDArray[np.generic],
    calibration: Calibration,
    depth: DepthMap | None,
    traditional: bool,
    options: dict[str, Any],
) -> Rendering:
    from . import render as run
    from . import traditional as run_traditional

    report.announce_compilation("lfrender")
    if traditional:
        return run_traditional(pixels, calibration)
    try:
        return run(pixels, calibration, depth, **options)
    except LightFieldError:
        raise
    except ValueError as error:
        if all(value is None for value in options.values()):
            raise
        raise click.UsageError(str(error)) from error


def _at_most_one(*pairs: Any) -> None:
    given = [name for name, value in zip(pairs[::2], pairs[1::2], strict=True) if value is not None]
    if len(given) > 1:
        raise click.UsageError(f"{given[0]} and {given[1]} exclude each other")


def _sharpen_width(text: str | None) -> float | Literal["auto"] | None:
    if text is None or text == "auto":
        return text  # type: ignore[return-value]
    try:
        return float(text)
    except ValueError:
        raise click.UsageError(f"--sharpen must be auto or a number of output pixels, got {text!r}") from None


def _settings(
    depth: DepthMap | None, patch_size: float | None, sharpen: float | Literal["auto"] | None = None
) -> dict[str, Any]:
    """How a picture was rendered, as stored in its file."""
    sharpened = {} if sharpen is None else {"sharpen": sharpen}
    if depth is not None:
        return {"rendering": "all in focus", "preset": depth.preset, **sharpened}
    if patch_size is not None:
        return {"rendering": "one patch size", "patch_size": patch_size, **sharpened}
    return {"rendering": "traditional"}


def _camera_figures(calibration: Calibration) -> dict[str, Any]:
    return {
        "pitch": calibration.lattice.pitch,
        "lenses": len(calibration.lattice),
        "camera_source": calibration.source,
        "camera_confidence": calibration.confidence,
        "warnings": list(calibration.warnings),
    }


def _depth_figures(depth: DepthMap) -> dict[str, Any]:
    import numpy as np

    mode = np.asarray(depth.mode)
    shares = {name: float(np.mean(mode == code)) for name, code in _MODES.items()} if mode.size else {}
    sizes = np.abs(np.asarray(depth.patch_size))[mode != 0]
    from .depthmap import REASONS

    return {
        "modes": shares,
        "patch_size_median": float(np.median(sizes)) if sizes.size else float("nan"),
        "unresolved": {
            REASONS[code]: float(np.mean(depth.reason == code)) for code in np.unique(depth.reason[mode == 0])
        },
        "saved": depth.saved,
    }


def _distance_figures(depth: DepthMap, optics: Optics | None) -> dict[str, Any]:
    """Nearest, middle and farthest distance [m] of nine tenths of the lenses, where the optics are known."""
    if optics is None:
        return {}
    import numpy as np

    known = depth.distance(optics)
    known = known[~np.isnan(known)]
    low, median, high = np.quantile(known, (0.05, 0.5, 0.95), method="nearest") if known.size else [float("nan")] * 3
    return {"distance_median": float(median), "distance_range": [float(low), float(high)]}


_MODES = {"telescopic": 1, "binocular": -1, "unresolved": 0}


def _picture_figures(picture: Rendering) -> dict[str, Any]:
    import numpy as np

    return {
        "size": [picture.image.shape[1], picture.image.shape[0]],
        "scale": picture.scale,
        "valid": float(np.mean(picture.valid)),
        "affine": picture.affine,
    }


if __name__ == "__main__":
    main()
