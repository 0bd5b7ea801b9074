"""`lfrender refocus`, `views` and `lenslet`: refocused pictures, viewpoints, grids."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfcal.runtime import command_line as cl
from lfcal.runtime.output_file import check_folder, check_output

from .inputs import MOVING, CaptureInput
from .options import at_most_one, capture_command, declare, option_errors
from .printed import figures
from .printed.results import LensletResult, RefocusResult, ViewsResult

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal import Calibration

    from ..data.depth_map import DepthMap
    from ..data.rendering import Rendering
    from ..output.finish import Finish

__all__ = ["lenslet", "refocus", "views"]

# Pictures of an animation where no number is given: two seconds.
_PICTURES = 24
# Rows and columns of viewpoints where none are given.
_GRID = (5, 5)


@capture_command(
    RefocusResult,
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
        "How to write it": "eight_bits exposure tone white_balance",
    },
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
    at_most_one("--patch-size", sizes or None, "--at", at, "--stack", stack)
    at_most_one("--resize", given.resize, "--scale", given.scale, "--roi", capture.roi)
    moving = output.suffix.lower() in MOVING
    if moving and (at or len(sizes) == 1):
        raise click.UsageError(
            f"{output} moves through several depths: give --stack N, or another suffix"
        )
    if not (sizes or at or stack or moving):
        raise click.UsageError("give one of --patch-size, --at and --stack: the depth in focus")
    stack = stack if sizes or at or stack else _PICTURES
    uses = ("animation", "film") if moving else ("picture",)
    check_format(output, *uses)
    pixels = capture.read()
    check_format(output, *uses, dtype=pixels.dtype)
    pixels, calibration = capture.calibrate(pixels)
    depth = None
    # Without --scale the picture lies on the grid of `lfrender render`, which the depth decides.
    if at or stack or given.scale is None:
        depth = capture.analyze(pixels, calibration)
    with report.stage("render"), option_errors():
        from .. import focal_stack
        from .. import refocus as run
        from ..output.views import resize_view, scale_for_size
        from ..rendering.refocus import stack_depths

        drawing = {"aperture": given.aperture, "scale": given.scale, "depth": depth}
        if given.resize:
            drawing["scale"] = scale_for_size(calibration, given.resize)
        if depth is not None and stack:
            sizes = stack_depths(depth, stack)
        if len(sizes) > 1:
            pictures = focal_stack(pixels, calibration, sizes, **drawing)
        else:
            pictures = [run(pixels, calibration, *sizes, position=at, **drawing)]
        pictures = [_cut(picture, capture, calibration) for picture in pictures]
        if given.resize:
            pictures = [resize_view(picture, given.resize) for picture in pictures]
    settings = [
        {"rendering": "refocused", "patch_size": size, "at": at} for size in (sizes or (None,))
    ]
    paths, stated = capture.write(given, pictures, settings)
    what = "in focus at one depth"
    if len(pictures) > 1:
        what = f"{len(pictures)} depths"
    found: dict[str, Any] = {"picture": str(output)}
    named = str(output)
    if len(paths) > 1:
        found = {"pictures": list(map(str, paths))}
        named = f"{paths[0]} to {paths[-1].name}"
    found |= {"patch_sizes": sizes, **figures.picture_figures(pictures[0])}
    report.finish(
        found | figures.capture_figures(calibration, depth),
        *capture.sentences(calibration),
        figures.picture_sentence(named, pictures[0], what, report.took),
        *stated,
    )


def _cut(picture: Rendering, capture: CaptureInput, calibration: Calibration) -> Rendering:
    """The part of a picture that --roi asks for."""
    from ..output.views import crop_view

    if capture.roi is None:
        return picture
    return crop_view(picture, capture.roi, calibration.lattice)


@capture_command(
    ViewsResult,
    "lfrender views flat.png -o views --grid 5x5",
    "lfrender views flat.png -o pair.png --stereo",
    "lfrender views flat.png -o round.gif",
    "lfrender views flat.png -c camera.json -o scene --poses nerfstudio",
    output=("FOLDER|FILE", "Folder of a grid, or one file."),
    own={
        "What to draw: a grid of views in "
        "a folder, or one file": "grid stereo animation quilt poses optics",
        "How to draw it": "view_aperture scale resize",
        "How to write it": "grid_format eight_bits exposure tone white_balance",
    },
)
def views(capture: CaptureInput, given: Any) -> None:
    """Draw FLAT as seen from other places in the main lens: parallax.

    Every view is sharp at every depth.
    """
    others = "--stereo", given.stereo, "--animation", given.animation, "--quilt", given.quilt
    for option, value in (("--grid", given.grid), ("--poses", given.poses)):
        at_most_one(option, value, *others)
    at_most_one("--resize", given.resize, "--scale", given.scale)
    for option, value in (
        ("--resize", given.resize),
        ("--roi", capture.roi),
        ("--exposure", given.exposure),
    ):
        at_most_one(option, value, "--poses", given.poses)
    report = capture.report
    output = given.output
    still = given.grid or given.stereo or given.quilt or given.poses
    moves = output.suffix.lower() in (*MOVING, ".webp") and not output.is_dir()
    if given.animation is None and moves and not still:
        given.animation = _PICTURES
    given.suffix = f".{given.suffix.lstrip('.').lower()}"
    _check_views(given)
    pixels = capture.read()
    _check_views(given, pixels.dtype)
    pixels, calibration = capture.calibrate(pixels)
    depth = capture.analyze(pixels, calibration)
    offsets = _offsets(given, given.aperture * calibration.lattice.radius)
    found: dict[str, Any] = {"views": str(output), "offsets": offsets}
    given.settings = {"rendering": "views", "aperture": given.aperture, "preset": depth.preset}
    one_file = given.animation or given.stereo or given.quilt
    finish = capture.finish(given, output if one_file else Path(f"view{given.suffix}"))
    stated: list[str] = []
    with report.stage("render and write"), report.progress("views") as step, option_errors():
        if given.poses:
            found |= _write_posed(
                given, pixels, calibration, depth, offsets, partial(_counted, step)
            )
        else:
            drawn = _draw_views(capture, given, pixels, calibration, depth, offsets=offsets)
            pictures = _counted(step, drawn, len(offsets))
            stated = _write_views(capture, given, finish, pictures)
    stated += finish.sentences
    report.finish(
        {**found, **figures.capture_figures(calibration, depth)},
        *capture.sentences(calibration, depth),
        f"{output}: {len(offsets)} views, in {report.took}.",
        *stated,
    )


def _counted(step: Callable[[int, int], None], views: Iterable[Any], count: int) -> Iterator[Any]:
    """The views as they are drawn, with a step of the progress for each."""
    for number, view in enumerate(views, 1):
        step(number, count)
        yield view


def _offsets(given: Any, radius: float) -> list[tuple[float, float]]:
    """The viewpoints [px]."""
    from ..rendering.viewpoints import circle_offsets, grid_offsets

    if given.animation:
        return circle_offsets(given.animation, radius)
    if given.stereo:
        return [(-radius, 0.0), (radius, 0.0)]
    if given.quilt:
        return grid_offsets(1, given.quilt[0] * given.quilt[1], radius)
    rows, columns = given.grid or _GRID
    return grid_offsets(rows, columns, radius)


def _check_views(given: Any, dtype: Any = None) -> None:
    """Raise an error if the views could not be written."""
    from ..output.formats import FORMATS, check_format
    from ..output.posed_files import check_posed_folder
    from ..output.raw_video import check_raw_format
    from ..output.views import check_grid

    output = given.output
    if given.animation:
        check_format(output, "animation", "film", dtype=dtype)
    elif given.stereo or given.quilt:
        check_format(output, "picture", dtype=dtype)
    elif output.suffix.lower() in FORMATS and not output.is_dir():
        raise click.UsageError(
            f"{output} is one file: say what it shows with --stereo, --animation N or --quilt "
            "8x6, or give a folder"
        )
    elif given.suffix.startswith(".yuv"):
        check_raw_format(check_folder(output), given.suffix[1:])
    else:
        rows, columns = given.grid or _GRID
        if given.poses:
            check_grid(output, ".png")
            check_posed_folder(output, given.poses, rows * columns)
        else:
            check_grid(output, given.suffix, dtype, (rows, columns))


def _draw_views(
    capture: CaptureInput,
    given: Any,
    *flat_camera_depth: Any,
    offsets: list[Any],
) -> Iterator[Rendering]:
    from .. import views as run
    from ..output.views import resize_view, scale_for_size

    camera = flat_camera_depth[1]
    scale = given.scale
    if given.resize:
        scale = scale_for_size(camera, given.resize)
    for picture in run(*flat_camera_depth, offsets=offsets, scale=scale):
        if given.resize:
            picture = resize_view(picture, given.resize)
        yield _cut(picture, capture, camera)


def _write_views(
    capture: CaptureInput, given: Any, finish: Finish, pictures: Iterator[Rendering]
) -> list[str]:
    """Write the views; return sentences about them."""
    from ..output.formats import read_metadata
    from ..output.picture import write_finished
    from ..output.raw_video import write_view_videos
    from ..output.views import stereo_pair, write_grid, write_quilt
    from ..sequence.film_file import write_moving

    output = given.output
    options: dict[str, Any] = {"settings": given.settings, "embedded": read_metadata(capture.flat)}
    if given.animation:
        write_moving(output, pictures, finish)
    elif given.quilt:
        columns, rows = given.quilt
        ending = write_quilt(output, pictures, columns, rows, finish, **options)
        if not output.stem.endswith(ending):
            return [
                "Players take the grid from the name: call it "
                f"{output.stem}{ending}{output.suffix} for them."
            ]
    elif given.stereo:
        write_finished(output, stereo_pair(*pictures), finish, **options)
    elif given.suffix.startswith(".yuv"):
        write_view_videos(output, pictures, given.suffix[1:], finish)
    else:
        columns = (given.grid or _GRID)[1]
        write_grid(output, pictures, columns, given.suffix, finish=finish, **options)
    return []


def _write_posed(
    given: Any,
    pixels: NDArray[Any],
    calibration: Calibration,
    depth: DepthMap,
    offsets: list[Any],
    counted: Any,
) -> dict[str, Any]:
    """Write views with their cameras; return figures about these."""
    from lfcal import Optics

    from ..output.posed_files import write_posed_views
    from ..rendering.viewpoints import still_depth, views_with_depth

    known = given.optics and Optics.load(given.optics)
    still = still_depth(depth)
    drawn = views_with_depth(
        pixels, calibration, depth, offsets=offsets, scale=given.scale, still=still
    )
    pictures = counted(drawn, len(offsets))
    rig = write_posed_views(
        given.output, given.poses, pictures, calibration, depth, offsets, still, known
    )
    positions = [camera.position.tolist() for camera in rig.cameras]
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
@cl.report_options(LensletResult)
def lenslet(report: cl.Report, given: Any) -> None:
    """Turn a grid of views into the flat of a regular lens array, or the reverse.

    Each pixel of the views becomes a lens with one pixel of each view under it, row by row. INPUT
    is a folder of views, or files. With a camera file, INPUT is such a flat, whose views are
    written as they are, pixel by pixel.
    """
    from ..output.lenslet import lenslet_image, read_view_grid
    from ..output.picture import write_picture

    output = given.output
    camera_file = given.output.with_suffix(".json")
    if given.camera is not None:
        _write_pixel_views(report, given)
        return
    check_output(output, (".png", ".tif", ".tiff"))
    check_output(camera_file, (".json",))
    with report.stage("read"):
        flat, camera = lenslet_image(views := read_view_grid(given.inputs, given.grid))
    with report.stage("write"):
        write_picture(output, flat)
        camera.save(camera_file)
    (rows, columns), (width, height) = views.shape[:2], camera.image_size
    if (problem := figures.few_pixels_problem(min(rows, columns))) is not None:
        report.warn(problem)
    report.finish(
        {
            "flat": str(output),
            "camera": str(camera_file),
            "grid": [rows, columns],
            "size": [width, height],
        },
        f"{output}: {width} x {height} px, {columns} x {rows} under each lens, and "
        f"{camera_file}, in {report.took}.",
    )


def _write_pixel_views(report: cl.Report, given: Any) -> None:
    """Write the views of the flat of a regular array."""
    from lfcal import load, read_flat

    from ..output.lenslet import lenslet_views
    from ..output.views import check_grid, write_grid

    suffix = f".{given.suffix.lstrip('.').lower()}"
    if len(given.inputs) > 1 or given.grid:
        raise click.UsageError("with a camera file, one flat is wanted, and its grid is known")
    check_grid(given.output, suffix)
    with report.stage("read"):
        flat = read_flat(given.inputs[0])
        views = lenslet_views(flat, load(given.camera, (flat.shape[1], flat.shape[0])))
    rows, columns, height, width = views.shape[:4]
    with report.stage("write"):
        write_grid(given.output, views.reshape(-1, *views.shape[2:]), columns, suffix)
    found = {"views": str(given.output), "grid": [rows, columns], "size": [width, height]}
    report.finish(
        found,
        f"{given.output}: {rows} x {columns} views of {width} x {height} px, in {report.took}.",
    )
