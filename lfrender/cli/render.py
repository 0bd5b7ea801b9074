"""`lfrender render`: one picture of a flat, sharp everywhere or drawn with one patch size."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfcal import LightFieldError
from lfcal.runtime import console

from ..output.metadata import read_metadata
from ..output.picture import check_picture, write_picture
from ..runtime.background_imports import import_in_background
from .figures import camera_figures, depth_figures, picture_figures, settings_of
from .inputs import analysed, camera_of, in_colour, read_depth
from .options import CAMERA, INPUT, OUTPUT, WITHOUT_CAMERA, at_most_one, cluster_options, flat_argument, preset_option

if TYPE_CHECKING:
    from typing import Literal

    import numpy as np
    from numpy.typing import NDArray

    from lfcal import Calibration

    from ..data.depth_map import DepthMap
    from ..data.rendering import Rendering
    from .inputs import Mosaic

__all__ = ["render"]


@click.command(
    epilog=console.help_examples(
        "lfrender render flat.png -o picture.tif",
        "lfrender render flat.png -c camera.json --depth depth.npz --scale 12 -o picture.png",
        "lfrender render flat.png --white white.png --patch-size -8.5 -o binocular.png",
    )
)
@flat_argument
@click.option("-o", "--output", type=OUTPUT, required=True, metavar="PICTURE", help="Picture to write: .tif, .png, ...")
@click.option("-c", "--camera", type=INPUT, help=CAMERA + WITHOUT_CAMERA)
@click.option("--white", type=INPUT, help="Calibrate from this white image of the same camera.")
@click.option("--depth", "depth_file", type=INPUT, help="Depth map made by 'lfrender analyze'.")
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
@cluster_options
@preset_option
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
    at_most_one("--depth", depth_file, "--patch-size", patch_size, "--traditional", traditional or None)
    at_most_one("--camera", camera, "--white", white)
    at_most_one("--scale", scale, "--traditional", traditional or None)
    at_most_one("--sharpen", sharpen, "--traditional", traditional or None)
    at_most_one("--roi", roi, "--sharpen", sharpen, "--traditional", traditional or None, "--tile", tile)
    at_most_one("--workers", workers, "--scheduler", scheduler)
    at_most_one("--workers or --scheduler", workers or scheduler, "--roi", roi, "--sharpen", sharpen)
    at_most_one("--workers or --scheduler", workers or scheduler, "--traditional", traditional or None)
    width = _sharpen_width(sharpen)
    if blend and patch_size is None:
        raise click.UsageError("--blend needs --patch-size")
    if not traditional:
        from . import large as large_cli

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
    import_in_background(
        "lfrender.rendering.render", *(["tifffile"] if output.suffix.lower() in (".tif", ".tiff") else [])
    )
    with report.stage("read"):
        from lfcal import read_flat

        pixels = read_flat(flat)
        check_picture(output, pixels.dtype, alpha)
    with report.stage("calibrate"):
        calibration = camera_of(report, flat, pixels, camera, white, mosaic)
        pixels = in_colour(pixels, calibration)
    depth = None
    if not traditional and patch_size is None:
        with report.stage("analyze"):
            if depth_file:
                depth = read_depth(depth_file)
            else:
                from ..rendering.render import expand_roi

                needed = expand_roi(roi, calibration) if roi else None
                depth = analysed(report, pixels, calibration, preset, roi=needed)
    options = {"patch_size": patch_size, "scale": scale, "blend": blend or None, "sharpen": width, "roi": roi}
    with report.stage("render"):
        picture = _render(report, pixels, calibration, depth, traditional, options)
    with report.stage("write"):
        write_picture(
            output, picture, alpha=alpha, settings=settings_of(depth, patch_size, width), embedded=read_metadata(flat),
            compress=compress,
        )  # fmt: skip
    figures = {**camera_figures(calibration, depth), **(depth_figures(depth) if depth else {})}
    report.finish({"picture": str(output), **picture_figures(picture), **figures})


def _render(
    report: Any,
    pixels: NDArray[np.generic],
    calibration: Calibration,
    depth: DepthMap | None,
    traditional: bool,
    options: dict[str, Any],
) -> Rendering:
    from .. import render as run
    from .. import traditional as run_traditional

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


def _sharpen_width(text: str | None) -> float | Literal["auto"] | None:
    if text is None or text == "auto":
        return text  # type: ignore[return-value]
    try:
        return float(text)
    except ValueError:
        raise click.UsageError(f"--sharpen must be auto or a number of output pixels, got {text!r}") from None
