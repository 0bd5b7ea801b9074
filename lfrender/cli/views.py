"""`lfrender refocus` and `views`: another depth in focus, or the scene seen from elsewhere in the main lens."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from lfcal.runtime import console
from lfcal.runtime.output_file import check_folder

from ..sequence.animation import MOVING_SUFFIXES, PICTURES, check_moving, write_moving
from .figures import (
    camera_figures,
    camera_sentence,
    capture_figures,
    depth_sentences,
    eight_bits_sentence,
    picture_figures,
    picture_sentence,
)
from .inputs import CaptureInput
from .options import INPUT, at_most_one, capture_command, eight_bits_option, grid_size, option_errors, scale_option

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal import Calibration

    from ..data.depth_map import DepthMap
    from ..data.rendering import Rendering

__all__ = ["refocus", "views"]

_View = TypeVar("_View")
# Suffixes that no folder has, of files that are not written.
_NO_FOLDERS = frozenset({".apng", ".avi", ".m4v", ".mov", ".mpeg", ".mpg", ".webm", ".wmv"})


@capture_command(
    "lfrender refocus flat.png --at 700 420 -o picture.tif",
    "lfrender refocus flat.png -c camera.json -o stack.tif --stack 12",
    "lfrender refocus flat.png -o focus.mp4",
    output=("PICTURE", "Picture to write: .tif, .jpg, ...; or .gif, .mp4: from far to near and back.", ".png"),
    preset=False,
)
@console.grouped(
    "What to draw",
    click.option("--at", type=float, nargs=2, metavar="X Y", help="Focus on this place [px of the flat]."),
    click.option(
        "--patch-size",
        "patch_sizes",
        type=float,
        multiple=True,
        help="Signed patch size [px] in focus: > 0 telescopic, < 0 binocular. Several times: a focal stack.",
    ),
    click.option(
        "--stack", type=click.IntRange(1), metavar="N", help="N pictures from the farthest depth to the nearest."
    ),
    click.option(
        "--aperture", type=float, default=1.0, show_default=True, help="Part of the aperture used, 0.05 to 1."
    ),
    scale_option,
    eight_bits_option,
)
def refocus(
    capture: CaptureInput,
    output: Path,
    patch_sizes: tuple[float, ...],
    at: tuple[float, float] | None,
    stack: int | None,
    aperture: float,
    scale: float | None,
    eight_bits: bool,
) -> None:
    """Draw FLAT in focus at one depth, out of focus before and behind.

    Several depths make a focal stack on one grid: pages of one TIFF, or PICTURE_01.png and so on; as .gif, .mp4 or .mkv
    an animation.
    """
    at_most_one("--patch-size", patch_sizes or None, "--at", at, "--stack", stack)
    moving = output.suffix.lower() in MOVING_SUFFIXES
    if not (patch_sizes or at or stack):
        if not moving:
            raise click.UsageError("give one of --patch-size, --at and --stack: the depth in focus")
        stack = PICTURES
    if moving and (at or len(patch_sizes) == 1):
        raise click.UsageError(f"{output} moves through several depths: give --stack N, or another suffix")
    from ..output.picture import check_picture

    check = check_moving if moving else check_picture
    check(output, inputs=capture.files)
    pixels = capture.read()
    check(output, pixels.dtype)
    pixels, calibration = capture.calibrate(pixels)
    depth = capture.analyze(pixels, calibration) if at or stack else None
    with capture.report.stage("render"), option_errors(0):
        from .. import focal_stack
        from .. import refocus as run
        from ..rendering.refocus import stack_depths

        sizes = stack_depths(depth, stack) if depth is not None and stack else list(patch_sizes)
        if len(sizes) > 1:
            pictures = focal_stack(pixels, calibration, sizes, aperture=aperture, scale=scale)
        else:
            one = sizes[0] if sizes else None
            pictures = [run(pixels, calibration, one, position=at, depth=depth, aperture=aperture, scale=scale)]
    settings = [{"rendering": "refocused", "patch_size": size, "at": at} for size in (sizes or (None,))]
    paths, stated = _write_refocused(capture, output, pictures, settings, eight_bits)
    written = {"picture": str(output)} if len(paths) == 1 else {"pictures": [str(path) for path in paths]}
    figures = {**picture_figures(pictures[0]), **camera_figures(calibration, depth)}
    what = f"{len(pictures)} depths" if len(pictures) > 1 else "in focus at one depth"
    named = output if len(paths) == 1 else f"{paths[0]} to {paths[-1].name}"
    capture.report.finish(
        {**written, "patch_sizes": sizes, **figures},
        camera_sentence(calibration, capture.camera),
        picture_sentence(named, pictures[0], what, capture.report.took), *stated,
    )  # fmt: skip


def _write_refocused(
    capture: CaptureInput, output: Path, pictures: list[Rendering], settings: list[dict[str, Any]], eight_bits: bool
) -> tuple[list[Path], list[str]]:
    """Write one picture, a stack or an animation; the files, and what is to be said about them."""
    from ..output.metadata import read_metadata
    from ..output.picture import eight_bits as to_eight_bits
    from ..output.picture import needs_eight_bits, write_picture, write_stack

    first, stated = pictures[0], []
    moving = output.suffix.lower() in MOVING_SUFFIXES
    if first.image.dtype.name != "uint8" and (eight_bits or needs_eight_bits(output, first)):
        stated = [eight_bits_sentence(first.white, first.image.dtype)]
        pictures = [to_eight_bits(picture) for picture in pictures]
    with capture.report.stage("write"):
        embedded = read_metadata(capture.flat)
        if moving:
            write_moving(output, [*pictures, *pictures[-2:0:-1]])
        elif len(pictures) > 1:
            return write_stack(output, pictures, settings=settings, embedded=embedded), stated
        else:
            write_picture(output, pictures[0], settings=settings[0], embedded=embedded)
    return [output], stated


@capture_command(
    "lfrender views flat.png -o views --grid 5x5",
    "lfrender views flat.png -o pair.png --stereo",
    "lfrender views flat.png -o round.gif",
    "lfrender views flat.png -c camera.json -o scene --poses nerfstudio",
    output=("FOLDER|FILE", "Folder of a grid, or one file."),
)
@console.grouped(
    "What to draw: a grid of views in a folder, or one file",
    click.option(
        "--grid", metavar="ROWSxCOLUMNS", help="Pictures on a grid of viewpoints, row1_column1 ... [default: 5x5]"
    ),
    click.option("--stereo", is_flag=True, help="The view of the left eye, and beside it that of the right one."),
    click.option(
        "--animation",
        type=click.IntRange(2),
        metavar="N",
        help=f"N views around a circle; {PICTURES} where the output is .gif, .mp4 or .mkv.",
    ),
    click.option(
        "--quilt",
        metavar="COLUMNSxROWS",
        help="Views from left to right in one picture, for holographic displays: 8x6.",
    ),
    click.option(
        "--poses",
        type=click.Choice(["nerfstudio", "colmap", "rvs"]),
        help="The grid with cameras, depth and masks for this program; metric where the optics are known.",
    ),
    click.option("--optics", type=INPUT, help="Lengths of the camera, for --poses, if its file does not have them."),
)
@console.grouped(
    "How to draw it",
    click.option(
        "--aperture",
        type=click.FloatRange(0, 1, min_open=True),
        default=0.7,
        show_default=True,
        help="How far from the middle, as a part of the radius of the microimages: more parallax, less light.",
    ),
    scale_option,
    click.option("--resize", type=console.SizeOption(), help="Size of the views [px]."),
    click.option(
        "--format", "suffix", default="tif", show_default=True, help="Of the grid's pictures: tif, png, yuv, ..."
    ),
    eight_bits_option,
)
def views(
    capture: CaptureInput,
    output: Path,
    grid: str | None,
    stereo: bool,
    animation: int | None,
    quilt: str | None,
    poses: str | None,
    optics: Path | None,
    aperture: float,
    scale: float | None,
    suffix: str,
    resize: tuple[int, int] | None,
    eight_bits: bool,
) -> None:
    """Draw FLAT as seen from other places in the main lens: parallax.

    Every view is sharp at every depth.
    """
    at_most_one("--grid", grid, "--stereo", stereo or None, "--animation", animation, "--quilt", quilt)
    at_most_one("--poses", poses, "--stereo", stereo or None, "--animation", animation, "--quilt", quilt)
    at_most_one("--resize", resize, "--scale", scale)
    at_most_one("--resize", resize, "--poses", poses)
    if animation is None and output.suffix.lower() in MOVING_SUFFIXES and not (grid or stereo or quilt or poses):
        animation = PICTURES
    form = _ViewForm(
        *grid_size("--grid", grid or "5x5"), f".{suffix.lstrip('.').lower()}", animation, stereo,
        grid_size("--quilt", quilt) if quilt is not None else None, poses,
    )  # fmt: skip
    form.check(output, inputs=capture.files)
    pixels = capture.read()
    form.check(output, pixels.dtype)
    pixels, calibration = capture.calibrate(pixels)
    depth = capture.analyze(pixels, calibration)
    report, offsets = capture.report, form.offsets(aperture * calibration.lattice.radius)
    figures: dict[str, Any] = {"views": str(output), "offsets": offsets}
    with report.stage("render and write"), report.progress("views", len(offsets)) as advance:
        if poses:
            figures |= _write_posed(output, poses, pixels, calibration, depth, offsets, scale, optics, advance)
        else:
            from .. import views as run
            from ..output.metadata import read_metadata
            from ..output.views import resize_view, scale_for_size

            with option_errors(0):
                scale = scale if resize is None else scale_for_size(calibration, resize)
                pictures: Iterator[Rendering] = run(pixels, calibration, depth, offsets=offsets, scale=scale)
            if resize is not None:
                pictures = (resize_view(picture, resize) for picture in pictures)
            if eight_bits:
                from ..output.picture import eight_bits as to_eight_bits

                pictures = (to_eight_bits(picture) for picture in pictures)
            settings = {"rendering": "views", "aperture": aperture, "preset": depth.preset}
            options = {"settings": settings, "embedded": read_metadata(capture.flat)}
            figures["views"] = str(form.write(output, _advance_with(pictures, advance), options))
    if pixels.dtype.name != "uint8" and (eight_bits or form.holds_eight_bits(output)):
        stated = [eight_bits_sentence(calibration.white_level, pixels.dtype)]
    else:
        stated = []
    report.finish(
        {**figures, **capture_figures(calibration, depth)},
        camera_sentence(calibration, capture.camera), *depth_sentences(calibration, depth),
        f"{figures['views']}: {len(offsets)} views, in {report.took}.", *stated,
    )  # fmt: skip


@dataclass(frozen=True)
class _ViewForm:
    """What views are written as: a grid, unless another form is given."""

    rows: int
    columns: int
    suffix: str
    animation: int | None
    stereo: bool
    quilt: tuple[int, int] | None
    poses: str | None

    def offsets(self, radius: float) -> list[tuple[float, float]]:
        """The viewpoints [px]."""
        from ..rendering.viewpoints import circle_offsets, grid_offsets

        if self.animation:
            return circle_offsets(self.animation, radius)
        if self.quilt:
            return grid_offsets(1, self.quilt[0] * self.quilt[1], radius)
        return [(-radius, 0.0), (radius, 0.0)] if self.stereo else grid_offsets(self.rows, self.columns, radius)

    def check(self, output: Path, dtype: Any = None, inputs: Any = ()) -> None:
        """Raise an error if the views could not be written."""
        from ..output.formats import FORMATS
        from ..output.picture import check_picture
        from ..output.raw_video import check_raw_format
        from ..output.views import check_animation, check_grid

        if self.animation:
            check = check_moving if output.suffix.lower() in MOVING_SUFFIXES else check_animation
            check(output, dtype, inputs)
        elif self.stereo or self.quilt:
            check_picture(output, dtype, inputs=inputs)
        elif output.suffix.lower() in _NO_FOLDERS and not output.is_dir():
            raise click.UsageError(
                f"{output}: films and animations are written as {', '.join(sorted(MOVING_SUFFIXES))}"
            )
        elif output.suffix.lower() in FORMATS and not output.is_dir():
            raise click.UsageError(
                f"{output} is one file: say what it shows with --stereo, --animation N or --quilt 8x6, or give a folder"
            )
        elif self.suffix.startswith(".yuv"):
            check_raw_format(check_folder(output), self.suffix[1:])
        else:
            check_grid(output, ".png" if self.poses else self.suffix, None if self.poses else dtype, inputs)

    def holds_eight_bits(self, output: Path) -> bool:
        """Whether the files have 8 bits a channel whatever the flat has."""
        from ..output.formats import FORMATS

        if self.animation:
            return output.suffix.lower() != ".mkv"
        kind = FORMATS.get(output.suffix.lower() if self.stereo or self.quilt else self.suffix)
        return kind is not None and kind.pixel_types == ("uint8",)

    def write(self, output: Path, pictures: Iterator[Rendering], options: dict[str, Any]) -> Path:
        """Write the views; returns where."""
        from ..output.picture import write_picture
        from ..output.raw_video import write_view_videos
        from ..output.views import stereo_pair, write_animation, write_grid, write_quilt

        if self.animation:
            write = write_moving if output.suffix.lower() in MOVING_SUFFIXES else write_animation
            write(output, pictures)
        elif self.quilt:
            return write_quilt(output, pictures, *self.quilt, **options)
        elif self.stereo:
            write_picture(output, stereo_pair(*pictures), **options)
        elif self.suffix.startswith(".yuv"):
            write_view_videos(output, pictures, self.suffix[1:])
        else:
            write_grid(output, pictures, self.columns, self.suffix, **options)
        return output


def _write_posed(
    output: Path,
    kind: str,
    pixels: NDArray[Any],
    calibration: Calibration,
    depth: DepthMap,
    offsets: list[tuple[float, float]],
    scale: float | None,
    optics: Path | None,
    advance: Callable[[str], None],
) -> dict[str, Any]:
    """Write views with their cameras; returns figures about these."""
    from lfcal import Optics

    from ..output.posed_files import write_posed_views
    from ..rendering.viewpoints import still_depth, views_with_depth

    known, still = Optics.load(optics) if optics is not None else None, still_depth(depth)
    with option_errors(0):
        drawn = views_with_depth(pixels, calibration, depth, offsets=offsets, scale=scale, still=still)
    counted = _advance_with(drawn, advance)
    rig = write_posed_views(output, kind, counted, calibration, depth, offsets, still, known)
    positions = [camera.position.tolist() for camera in rig.cameras]
    return {"unit": rig.unit, "camera_error": rig.error, "positions": positions}


def _advance_with(views: Iterable[_View], advance: Callable[[str], None]) -> Iterator[_View]:
    """The views as they are drawn, with a step of the progress for each."""
    for view in views:
        advance("")
        yield view
