"""`lfrender refocus` and `views`: another depth in focus, or the scene seen from elsewhere in the main lens."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfcal.runtime import console

from ..output.metadata import read_metadata
from ..output.picture import check_picture, write_picture
from .figures import camera_figures, capture_figures, picture_figures
from .inputs import CaptureInput
from .options import at_most_one, capture_command, grid_size, option_errors, scale_option

if TYPE_CHECKING:
    from ..data.rendering import Rendering

__all__ = ["refocus", "views"]


@capture_command(
    "lfrender refocus flat.png --at 700 420 -o picture.tif",
    "lfrender refocus flat.png -c camera.json -o stack.tif --stack 12",
    output=("PICTURE", "Picture to write: .tif, .png, ..."),
    preset=False,
)
@click.option(
    "--patch-size",
    "patch_sizes",
    type=float,
    multiple=True,
    help="Signed patch size [px] in focus: > 0 telescopic, < 0 binocular. Several times: a focal stack.",
)
@click.option("--at", type=float, nargs=2, metavar="X Y", help="Focus on this place [px of the flat] instead.")
@click.option("--stack", type=click.IntRange(1), metavar="N", help="N pictures from the farthest depth to the nearest.")
@click.option("--aperture", type=float, default=1.0, show_default=True, help="Part of the aperture used, 0.05 to 1.")
@scale_option
def refocus(
    capture: CaptureInput,
    output: Path,
    patch_sizes: tuple[float, ...],
    at: tuple[float, float] | None,
    stack: int | None,
    aperture: float,
    scale: float | None,
) -> None:
    """Render FLAT in focus at one depth, out of focus before and behind it.

    Several depths make a focal stack on one grid: pages of one TIFF, or PICTURE_01.png and so on.
    """
    at_most_one("--patch-size", patch_sizes or None, "--at", at, "--stack", stack)
    if not (patch_sizes or at or stack):
        raise click.UsageError("give one of --patch-size, --at and --stack: the depth in focus")
    check_picture(output, inputs=capture.files)
    pixels = capture.read()
    check_picture(output, pixels.dtype)
    pixels, calibration = capture.calibrate(pixels)
    depth = capture.analyze(pixels, calibration) if at or stack else None
    with capture.report.stage("render"), option_errors(0):
        from .. import focal_stack
        from .. import refocus as run
        from ..rendering.refocus import stack_depths

        capture.report.announce_compilation("lfrender")
        sizes = stack_depths(depth, stack) if depth is not None and stack else list(patch_sizes)
        if len(sizes) > 1:
            pictures = focal_stack(pixels, calibration, sizes, aperture=aperture, scale=scale)
        else:
            one = sizes[0] if sizes else None
            pictures = [run(pixels, calibration, one, position=at, depth=depth, aperture=aperture, scale=scale)]
    with capture.report.stage("write"):
        settings = [{"rendering": "refocused", "patch_size": size, "at": at} for size in (sizes or (None,))]
        embedded = read_metadata(capture.flat)
        if len(pictures) > 1:
            from ..output.picture import write_stack

            paths = write_stack(output, pictures, settings=settings, embedded=embedded)
        else:
            write_picture(output, pictures[0], settings=settings[0], embedded=embedded)
            paths = [output]
    written = {"picture": str(output)} if len(paths) == 1 else {"pictures": [str(path) for path in paths]}
    figures = {**picture_figures(pictures[0]), **camera_figures(calibration, depth)}
    capture.report.finish({**written, "patch_sizes": sizes, **figures})


@capture_command(
    "lfrender views flat.png -o views --grid 5x5",
    "lfrender views flat.png -o pair.png --stereo",
    "lfrender views flat.png -o round.gif --animation 24",
    output=("FOLDER|FILE", "Folder of a grid, or one file."),
)
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
@scale_option
@click.option(
    "--format", "suffix", default="tif", show_default=True, help="Format of the grid's pictures: tif, png, yuv, ..."
)
@click.option("--resize", type=console.SizeOption(), help="Size of the views [px].")
def views(
    capture: CaptureInput,
    output: Path,
    grid: str | None,
    stereo: bool,
    animation: int | None,
    aperture: float,
    scale: float | None,
    suffix: str,
    resize: tuple[int, int] | None,
) -> None:
    """Render FLAT sharp at every depth as seen from other places in the main lens: parallax."""
    at_most_one("--grid", grid, "--stereo", stereo or None, "--animation", animation)
    from .. import views as run
    from ..output.views import resize_view, scale_for_size
    from ..rendering.viewpoints import circle_offsets, grid_offsets

    report = capture.report
    if resize is not None and scale is not None:
        raise click.UsageError("--resize and --scale exclude each other")
    rows, columns = grid_size("--grid", grid or "5x5")
    suffix = f".{suffix.lstrip('.').lower()}"
    _check_views(output, animation, stereo, suffix, inputs=capture.files)
    pixels = capture.read()
    _check_views(output, animation, stereo, suffix, pixels.dtype)
    pixels, calibration = capture.calibrate(pixels)
    depth = capture.analyze(pixels, calibration)
    radius = aperture * calibration.lattice.radius
    with report.stage("render and write"):
        offsets = circle_offsets(animation, radius) if animation else grid_offsets(rows, columns, radius)
        if stereo:
            offsets = [(-radius, 0.0), (radius, 0.0)]
        with option_errors(0):
            scale = scale if resize is None else scale_for_size(calibration, resize)
            pictures: Iterator[Rendering] = run(pixels, calibration, depth, offsets=offsets, scale=scale)
        if resize is not None:
            pictures = (resize_view(picture, resize) for picture in pictures)
        options: dict[str, Any] = {
            "settings": {"rendering": "views", "aperture": aperture, "preset": depth.preset},
            "embedded": read_metadata(capture.flat),
        }
        with report.progress("views", len(offsets)) as advance:
            _write(output, _advance_with(pictures, advance), bool(animation), stereo, columns, suffix, options)
    report.finish({"views": str(output), "offsets": offsets, **capture_figures(calibration, depth)})


def _write(
    output: Path,
    pictures: Iterator[Rendering],
    animation: bool,
    stereo: bool,
    columns: int,
    suffix: str,
    options: dict[str, Any],
) -> None:
    """Write the views as an animation, a stereo pair or a grid."""
    from ..output.views import stereo_pair, write_animation, write_grid

    if animation:
        write_animation(output, pictures)
    elif stereo:
        write_picture(output, stereo_pair(*pictures), **options)
    elif suffix.startswith(".yuv"):
        from ..output.raw_video import write_view_videos

        write_view_videos(output, pictures, suffix[1:])
    else:
        write_grid(output, pictures, columns, suffix, **options)


def _advance_with(pictures: Iterable[Rendering], advance: Callable[[str], None]) -> Iterator[Rendering]:
    """The pictures as they are drawn, with a step of the progress for each."""
    for picture in pictures:
        advance("")
        yield picture


def _check_views(
    output: Path, animation: int | None, stereo: bool, suffix: str, dtype: Any = None, inputs: Any = ()
) -> None:
    from ..output.views import check_animation, check_grid

    if animation:
        check_animation(output, dtype, inputs)
    elif stereo:
        check_picture(output, dtype, inputs=inputs)
    elif suffix.startswith(".yuv"):
        from ..output.raw_video import check_raw_format

        check_raw_format(output, suffix[1:])
    else:
        check_grid(output, suffix, dtype, inputs)
