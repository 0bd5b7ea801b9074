"""`lfrender refocus` and `views`: another depth in focus, or the scene seen from elsewhere in the main lens."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from lfcal.runtime import console

from .figures import camera_figures, capture_figures, picture_figures
from .inputs import CaptureInput
from .options import INPUT, at_most_one, capture_command, grid_size, option_errors, scale_option

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal import Calibration

    from ..data.depth_map import DepthMap
    from ..data.rendering import Rendering

__all__ = ["refocus", "views"]

_View = TypeVar("_View")


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
    from ..output.metadata import read_metadata
    from ..output.picture import check_picture, write_picture, write_stack

    check_picture(output, inputs=capture.files)
    pixels = capture.read()
    check_picture(output, pixels.dtype)
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
    with capture.report.stage("write"):
        settings = [{"rendering": "refocused", "patch_size": size, "at": at} for size in (sizes or (None,))]
        embedded = read_metadata(capture.flat)
        if len(pictures) > 1:
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
    "lfrender views flat.png -c camera.json -o scene --poses nerfstudio",
    output=("FOLDER|FILE", "Folder of a grid, or one file."),
)
@click.option(
    "--grid", metavar="ROWSxCOLUMNS", help="Pictures on a grid of viewpoints, row1_column1 ... [default: 5x5]"
)
@click.option("--stereo", is_flag=True, help="One picture: the view of the left eye, beside it that of the right one.")
@click.option("--animation", type=click.IntRange(2), metavar="N", help="N views around a circle: .gif, .png or .webp.")
@click.option(
    "--quilt", metavar="COLUMNSxROWS", help="Views from left to right in one picture, for holographic displays: 8x6."
)
@click.option(
    "--poses",
    type=click.Choice(["nerfstudio", "colmap", "rvs"]),
    help="The grid with cameras, depth and masks for this program; metric where the optics are known.",
)
@click.option("--optics", type=INPUT, help="Lengths of the camera, for --poses, if its file does not have them.")
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
    quilt: str | None,
    poses: str | None,
    optics: Path | None,
    aperture: float,
    scale: float | None,
    suffix: str,
    resize: tuple[int, int] | None,
) -> None:
    """Render FLAT sharp at every depth as seen from other places in the main lens: parallax."""
    at_most_one("--grid", grid, "--stereo", stereo or None, "--animation", animation, "--quilt", quilt)
    at_most_one("--poses", poses, "--stereo", stereo or None, "--animation", animation, "--quilt", quilt)
    at_most_one("--resize", resize, "--scale", scale)
    at_most_one("--resize", resize, "--poses", poses)
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
            settings = {"rendering": "views", "aperture": aperture, "preset": depth.preset}
            options = {"settings": settings, "embedded": read_metadata(capture.flat)}
            figures["views"] = str(form.write(output, _advance_with(pictures, advance), options))
    report.finish({**figures, **capture_figures(calibration, depth)})


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
        from ..output.picture import check_picture
        from ..output.raw_video import check_raw_format
        from ..output.views import check_animation, check_grid

        if self.animation:
            check_animation(output, dtype, inputs)
        elif self.stereo or self.quilt:
            check_picture(output, dtype, inputs=inputs)
        elif self.suffix.startswith(".yuv"):
            check_raw_format(output, self.suffix[1:])
        else:
            check_grid(output, ".png" if self.poses else self.suffix, None if self.poses else dtype, inputs)

    def write(self, output: Path, pictures: Iterator[Rendering], options: dict[str, Any]) -> Path:
        """Write the views; returns where."""
        from ..output.picture import write_picture
        from ..output.raw_video import write_view_videos
        from ..output.views import stereo_pair, write_animation, write_grid, write_quilt

        if self.animation:
            write_animation(output, pictures)
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
