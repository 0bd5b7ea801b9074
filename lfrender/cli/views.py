"""`lfrender refocus`, `views` and `lenslet`: refocused pictures, viewpoints, grids."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfcal.runtime import command_line as cl
from lfcal.runtime.output_file import check_folder, check_output

from ..runtime.types import Entries, Place
from . import figures
from .inputs import MOVING, CaptureInput
from .options import RESULTS, capture_command, declare, option_errors

if TYPE_CHECKING:
    from lfcal import Calibration
    from lfcal.runtime.arrays import Array

    from ..data.depth_map import DepthMap
    from ..data.rendering import Rendering

__all__ = ["lenslet", "refocus", "views"]

# Pictures of an animation where no number is given: two seconds.
_PICTURES = 24
# Rows and columns of viewpoints where none are given.
_GRID = (5, 5)


@capture_command(
    "refocus",
    "lfrender refocus flat.png --at 700 420 -o picture.tif",
    "lfrender refocus flat.png -c camera.json -o stack.tif --stack 12",
    "lfrender refocus flat.png -o focus.mp4",
    output=(
        "PICTURE",
        "Picture to write: .tif, .jpg, ...; or .gif, .mp4: from far to near and back.",
        ".png",
    ),
    own={
        "What to draw": "at patch_sizes stack focus_aperture scale resize",
        "How to write it": "eight_bits exposure tone white_balance quality",
    },
    exclusive=("patch_sizes at stack", "resize roi"),
)
def refocus(capture: CaptureInput, given: Any) -> None:
    """Draw FLAT in focus at one depth, out of focus before and behind.

    Several depths make a focal stack on one grid: pages of one TIFF, or PICTURE_01.png and so on;
    as .gif, .mp4 or .mkv an animation.
    """
    from ..output.formats import check_format

    report = capture.report
    output = given.output
    at = given.at
    sizes = list(given.patch_sizes)
    stack = given.stack
    moving = output.suffix.lower() in MOVING
    if moving and (at or len(sizes) == 1):
        raise click.UsageError(
            f"{output} moves through several depths: give --stack N, or another suffix"
        )
    if not (sizes or at or stack or moving):
        raise click.UsageError("give one of --patch-size, --at and --stack: the depth in focus")
    stack = stack if sizes or at or stack else _PICTURES
    uses = ("animation", "film") if moving else ("picture",)
    check_format(output, *uses, quality=given.quality)
    pixels = capture.read()
    check_format(output, *uses, dtype=pixels.dtype)
    pixels, calibration = capture.calibrate(pixels)
    depth = None
    # Without --scale the picture lies on the grid of `lfrender render`, which the depth decides.
    if at or stack or capture.depth_file or given.scale is None:
        depth = capture.analyze(pixels, calibration)
    with report.stage("render"), option_errors():
        from .. import focal_stack
        from .. import refocus as run
        from ..output.views import scale_for_size
        from ..rendering.refocus import stack_depths

        scale = scale_for_size(calibration, given.resize, given.scale)
        drawing = {"aperture": given.aperture, "scale": scale, "depth": depth}
        if depth is not None and stack:
            sizes = stack_depths(depth, stack)
        if len(sizes) > 1:
            pictures = focal_stack(pixels, calibration, sizes, **drawing)
        else:
            pictures = [run(pixels, calibration, *sizes, position=at, **drawing)]
        pictures = [_fit(picture, capture, given, calibration) for picture in pictures]
    settings = [
        {"rendering": "refocused", "patch_size": size, "at": at} for size in (sizes or (None,))
    ]
    paths, stated = capture.write(given, pictures, settings)
    found: Entries = {"picture": output}
    named = str(output)
    what = "in focus at one depth"
    if len(pictures) > 1:
        what = f"{len(pictures)} depths"
    if len(paths) > 1:
        found = {"pictures": paths}
        named = f"{paths[0]} to {paths[-1].name}"
    found |= {"patch_sizes": sizes, **figures.picture_figures(pictures[0])}
    closing = figures.picture_sentence(named, pictures[0], what, report.took)
    capture.conclude(found, calibration, depth, closing, *stated)


def _fit(
    picture: Rendering, capture: CaptureInput, given: Any, calibration: Calibration
) -> Rendering:
    """The part of a picture that --roi asks for, or all of it in the size of --resize."""
    from ..output.views import crop_view, resize_view

    if capture.roi is None:
        return resize_view(picture, given.resize)
    return crop_view(picture, capture.roi, calibration.lattice)


@capture_command(
    "views",
    "lfrender views flat.png -o views --grid 5x5",
    "lfrender views flat.png -o pair.png --stereo",
    "lfrender views flat.png -o round.gif",
    "lfrender views flat.png -c camera.json -o scene --poses nerfstudio",
    output=("FOLDER|FILE", "Folder of a grid, or one file."),
    own={
        "What to draw: a grid of views in "
        "a folder, or one file": "grid stereo animation quilt poses optics",
        "How to draw it": "view_aperture scale resize",
        "How to write it": "grid_format eight_bits exposure tone white_balance quality",
    },
    exclusive=(
        "grid stereo animation quilt",
        "poses stereo animation quilt",
        "resize poses",
        "roi poses",
        "exposure poses",
    ),
)
def views(capture: CaptureInput, given: Any) -> None:
    """Draw FLAT as seen from other places in the main lens: parallax.

    Every view is sharp at every depth.
    """
    report = capture.report
    output = given.output
    still = given.grid or given.stereo or given.quilt or given.poses
    moves = output.suffix.lower() in (*MOVING, ".webp") and not output.is_dir()
    if given.animation is None and moves and not still:
        given.animation = _PICTURES
    given.suffix = f".{given.suffix.lstrip('.').lower()}"
    given.grid = given.grid or _GRID
    _check_views(given)
    pixels = capture.read()
    _check_views(given, pixels.dtype)
    pixels, calibration = capture.calibrate(pixels)
    depth = capture.analyze(pixels, calibration)
    captured = (pixels, calibration, depth)
    offsets = _offsets(given, given.aperture * calibration.lattice.radius)
    found: Entries = {"views": output, "offsets": offsets}
    stated: list[str] = []
    with report.stage("render and write"), report.progress("views") as step, option_errors():

        def counted(drawn: Iterable[Any]) -> Iterator[Any]:
            """The views as they are drawn, with a step of the progress for each."""
            for number, view in enumerate(drawn, 1):
                step(number, len(offsets))
                yield view

        if given.poses:
            found |= _write_posed(given, captured, offsets, counted)
        else:
            from .. import views as run
            from ..output.views import scale_for_size

            scale = scale_for_size(calibration, given.resize, given.scale)
            drawn = run(*captured, offsets=offsets, scale=scale)
            pictures = (_fit(picture, capture, given, calibration) for picture in drawn)
            stated = _write_views(capture, given, counted(pictures), depth.preset)
    closing = f"{output}: {len(offsets)} views, in {report.took}."
    capture.conclude(found, calibration, depth, closing, *stated)


def _offsets(given: Any, radius: float) -> list[Place]:
    """The viewpoints [px]."""
    from ..rendering.viewpoints import circle_offsets, grid_offsets

    if given.animation:
        return circle_offsets(given.animation, radius)
    if given.stereo:
        return [(-radius, 0.0), (radius, 0.0)]
    if given.quilt:
        return grid_offsets(1, given.quilt[0] * given.quilt[1], radius)
    rows, columns = given.grid
    return grid_offsets(rows, columns, radius)


def _check_views(given: Any, dtype: Any = None) -> None:
    """Raise an error if the views could not be written."""
    from ..output.formats import FORMATS, check_format
    from ..output.posed_files import check_posed_folder
    from ..output.raw_video import check_raw_format
    from ..output.views import check_grid

    output = given.output
    needed = {"dtype": dtype, "quality": given.quality}
    if given.animation:
        check_format(output, "animation", "film", **needed)
    elif given.stereo or given.quilt:
        check_format(output, "picture", **needed)
    elif output.suffix.lower() in FORMATS and not output.is_dir():
        raise click.UsageError(
            f"{output} is one file: say what it shows with --stereo, --animation N or --quilt "
            "8x6, or give a folder"
        )
    elif given.poses:
        check_grid(output, ".png", quality=given.quality)
        check_posed_folder(output, given.poses, given.grid[0] * given.grid[1])
    elif given.suffix.startswith(".yuv"):
        check_raw_format(check_folder(output), given.suffix[1:], given.quality)
    else:
        check_grid(output, given.suffix, given.grid, **needed)


def _write_views(
    capture: CaptureInput, given: Any, pictures: Iterator[Rendering], preset: str
) -> list[str]:
    """Write the views; return sentences about them."""
    from ..output.formats import read_metadata
    from ..output.picture import write_finished
    from ..output.raw_video import write_view_videos
    from ..output.views import stereo_pair, write_grid, write_quilt
    from ..sequence.film_file import write_moving

    output = given.output
    settings = {"rendering": "views", "aperture": given.aperture, "preset": preset}
    options: Entries = {"settings": settings, "embedded": read_metadata(capture.flat)}
    one_file = given.animation or given.stereo or given.quilt
    first = next(pictures)
    finish = capture.finish(given, output if one_file else Path(f"view{given.suffix}"))
    finish = finish.measured(first)
    pictures = chain([first], pictures)
    stated = finish.sentences(first)
    if given.animation:
        write_moving(output, pictures, finish)
    elif given.quilt:
        columns, rows = given.quilt
        ending = write_quilt(output, pictures, columns, rows, finish, **options)
        if not output.stem.endswith(ending):
            named = f"{output.stem}{ending}{output.suffix}"
            stated.insert(0, f"Players take the grid from the name: call it {named} for them.")
    elif given.stereo:
        write_finished(output, stereo_pair(*pictures), finish, **options)
    elif given.suffix.startswith(".yuv"):
        write_view_videos(output, pictures, given.suffix[1:], finish)
    else:
        write_grid(output, pictures, given.grid[1], given.suffix, finish=finish, **options)
    return stated


def _write_posed(
    given: Any,
    captured: tuple[Array, Calibration, DepthMap],
    offsets: list[Place],
    counted: Callable[[Iterable[Any]], Iterator[Any]],
) -> Entries:
    """Write views with their cameras; return figures about these."""
    from lfcal import Optics

    from ..output.posed_files import write_posed_views
    from ..rendering.viewpoints import still_depth, views_with_depth

    optics = given.optics and Optics.load(given.optics)
    still = still_depth(captured[2])
    drawn = views_with_depth(*captured, offsets=offsets, scale=given.scale, still=still)
    placed = (*captured[1:], offsets, still, optics)
    rig = write_posed_views(given.output, given.poses, counted(drawn), *placed)
    positions = [camera.position for camera in rig.cameras]
    return {"unit": rig.unit, "camera_error": rig.error, "positions": positions}


@cl.command(
    "lfrender lenslet views -o flat.png",
    "lfrender lenslet 'cams/*.png' --grid 9x9 -o flat.tif",
    "lfrender lenslet flat.png -c flat.json -o views",
)
@cl.several_inputs("inputs", "INPUT...")
@cl.output_option(
    "FLAT|FOLDER",
    "Flat to write, .png or .tif, and beside it its camera file, .json; or folder of views.",
)
@declare("camera")
@cl.option(
    "--grid",
    cl.Pair("ROWSxCOLUMNS", "5x5"),
    "Of the views, if their names do not have row and column.",
)
@declare("grid_format")
@declare("quality")
@cl.report_options(RESULTS["lenslet"])
def lenslet(report: cl.Report, given: Any) -> None:
    """Turn a grid of views into the flat of a regular lens array, or the reverse.

    Each pixel of the views becomes a lens with one pixel of each view under it, row by row. INPUT
    is a folder of views, or files. With a camera file, INPUT is such a flat, whose views are
    written as they are, pixel by pixel.
    """
    if given.camera is not None:
        _write_pixel_views(report, given)
        return
    from ..output.lenslet import lenslet_image, read_view_grid
    from ..output.picture import write_picture

    output = given.output
    camera_file = output.with_suffix(".json")
    if given.quality is not None:
        raise click.UsageError("--quality is for views: a flat is written without any loss")
    check_output(output, (".png", ".tif", ".tiff"))
    check_output(camera_file, (".json",))
    with report.stage("read"):
        views = read_view_grid(given.inputs, given.grid)
        flat, camera = lenslet_image(views)
    with report.stage("write"):
        write_picture(output, flat)
        camera.save(camera_file)
    rows, columns = views.shape[:2]
    width, height = camera.image_size
    if (problem := figures.few_pixels_problem(min(rows, columns))) is not None:
        report.warn(problem)
    report.finish(
        {"flat": output, "camera": camera_file, "grid": (rows, columns), "size": (width, height)},
        f"{output}: {width} x {height} px, {columns} x {rows} under each lens, and "
        f"{camera_file}, in {report.took}.",
    )


def _write_pixel_views(report: cl.Report, given: Any) -> None:
    """Write the views of the flat of a regular array."""
    from lfcal import load, read_flat

    from ..output.lenslet import lenslet_views
    from ..output.views import check_grid, write_grid

    output = given.output
    suffix = f".{given.suffix.lstrip('.').lower()}"
    if len(given.inputs) > 1 or given.grid:
        raise click.UsageError("with a camera file, one flat is wanted, and its grid is known")
    check_grid(output, suffix, quality=given.quality)
    with report.stage("read"):
        flat = read_flat(given.inputs[0])
        views = lenslet_views(flat, load(given.camera, (flat.shape[1], flat.shape[0])))
    rows, columns, height, width = views.shape[:4]
    with report.stage("write"):
        pictures = views.reshape(-1, *views.shape[2:])
        write_grid(output, pictures, columns, suffix, quality=given.quality)
    report.finish(
        {"views": output, "grid": (rows, columns), "size": (width, height)},
        f"{output}: {rows} x {columns} views of {width} x {height} px, in {report.took}.",
    )
