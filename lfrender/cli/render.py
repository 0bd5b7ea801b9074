"""`lfrender render`: one picture of a flat, sharp everywhere or drawn with one patch size."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfcal.runtime import console

from ..large.size import is_large
from .figures import (
    camera_sentence,
    capture_figures,
    depth_sentences,
    eight_bits_sentence,
    picture_figures,
    picture_sentence,
    rendering_settings,
)
from .inputs import CaptureInput
from .options import (
    at_most_one,
    capture_command,
    cluster_options,
    connect_cluster,
    edges_option,
    eight_bits_option,
    option_errors,
    roi_option,
    scale_option,
)

if TYPE_CHECKING:
    from ..rendering.render import Detail

__all__ = ["render"]


@capture_command(
    "lfrender render flat.png -o picture.tif",
    "lfrender render flat.png -c camera.json --depth depth.npz --scale 12 -o picture.png",
    "lfrender render flat.png --white white.png --patch-size -8.5 -o binocular.png",
    output=("PICTURE", "Picture to write: .tif, .png, .jpg, ...", ".png"),
    white=True,
    mosaic=True,
)
@console.grouped(
    "What to draw",
    click.option(
        "--patch-size", type=float, help="One signed patch size [px] for all lenses: > 0 telescopic, < 0 binocular."
    ),
    click.option("--blend", is_flag=True, help="With --patch-size: the mean over lenses instead of the nearest one."),
    click.option("--traditional", is_flag=True, help="One pixel per microlens, the mean of its microimage."),
    scale_option,
    edges_option,
    roi_option("Draw only this part, between two opposite corners [px of the flat]."),
    click.option(
        "--detail",
        type=click.Choice(["natural", "off"]),
        help="Undo the blur of the microlenses, place by place, as noise allows. [default: natural, for depth maps]",
    ),
    click.option("--sharpen", hidden=True, expose_value=False, callback=lambda *given: _refuse_sharpen(given[2])),
)
@console.grouped(
    "How to write it",
    eight_bits_option,
    click.option("--alpha", is_flag=True, help="Make pixels that no lens has seen transparent (not in JPEG)."),
    click.option("--compress", is_flag=True, help="Write a TIFF in deflated tiles: smaller and slower."),
    click.option(
        "--tile",
        type=click.IntRange(16),
        metavar="PIXELS",
        help="Draw in tiles of this side, with little memory; an interrupted run is continued. [default: large flats]",
    ),
)
@cluster_options
def render(
    capture: CaptureInput,
    output: Path,
    patch_size: float | None,
    blend: bool,
    traditional: bool,
    scale: float | None,
    detail: Detail | None,
    eight_bits: bool,
    alpha: bool,
    compress: bool,
    tile: int | None,
    edges: bool | None,
    roi: tuple[float, float, float, float] | None,
    workers: int | None,
    scheduler: str | None,
) -> None:
    """Draw FLAT as one picture that is sharp at every depth.

    Without --depth, --patch-size and --traditional the depth is analysed first. A flat of more than 100 MB, as TIFF or
    Zarr, is read and drawn in tiles; the finished tiles of an interrupted run are used by the next one.
    """
    mean = "--traditional", traditional or None
    on_cluster = workers or scheduler
    at_most_one("--depth", capture.depth_file, "--patch-size", patch_size, *mean)
    at_most_one("--scale", scale, *mean)
    at_most_one("--detail", detail, "--patch-size", patch_size, *mean)
    at_most_one("--roi", roi, *mean, "--tile", tile)
    at_most_one("--workers", workers, "--scheduler", scheduler)
    at_most_one("--workers or --scheduler", on_cluster, "--roi", roi, *mean)
    for other in (("--depth", capture.depth_file), ("--patch-size", patch_size), ("--roi", roi), mean):
        at_most_one("--edges", edges or None, *other)
    if blend and patch_size is None:
        raise click.UsageError("--blend needs --patch-size")
    options: dict[str, Any] = {"patch_size": patch_size, "scale": scale, "blend": blend or None, "detail": detail}
    if not (traditional or roi):
        from ..output.ome import is_ome_name

        # A plain Zarr array is written tile by tile, OME-Zarr as a whole.
        plain_zarr = output.suffix.lower() == ".zarr" and not is_ome_name(output)
        in_tiles = on_cluster or tile is not None or plain_zarr
        if edges and (in_tiles or is_large(capture.flat)):
            raise click.UsageError("--edges is for flats that are analysed as a whole: leave it out here")
        if eight_bits and (in_tiles or is_large(capture.flat)):
            raise click.UsageError("--8bit is for flats that are drawn as a whole: write the pixels as they are")
        if in_tiles or is_large(capture.flat):
            from .large import render_in_tiles

            with connect_cluster(workers, scheduler, capture.report) as cluster:
                render_in_tiles(capture, output, alpha=alpha, compress=compress, tile=tile, cluster=cluster, **options)
            return
    from ..output.metadata import read_metadata
    from ..output.picture import check_picture, write_picture

    check_picture(output, alpha=alpha, inputs=capture.files)
    pixels = capture.read()
    check_picture(output, pixels.dtype, alpha)
    pixels, calibration = capture.calibrate(pixels)
    depth = None
    if not traditional and patch_size is None:
        needed = None
        if roi:
            from ..rendering.render import expand_roi

            with option_errors(roi):
                needed = expand_roi(roi, calibration)
        depth = capture.analyze(pixels, calibration, roi=needed, edges=edges)
    options["roi"] = roi
    with capture.report.stage("render"), option_errors(*options.values()):
        from .. import render as run
        from .. import traditional as run_traditional
        from ..rendering.traditional import TOO_LITTLE, resolves_too_little

        if depth is not None and not (scale or roi) and resolves_too_little(depth):
            traditional = True
            capture.report.warn(TOO_LITTLE.format("--scale"))
        picture = run_traditional(pixels, calibration) if traditional else run(pixels, calibration, depth, **options)
    from ..output.picture import eight_bits as to_eight_bits
    from ..output.picture import needs_eight_bits

    figures = {**picture_figures(picture), **capture_figures(calibration, depth)}
    stated = []
    if (eight_bits and picture.image.dtype.name != "uint8") or needs_eight_bits(output, picture):
        stated = [eight_bits_sentence(picture.white, picture.image.dtype)]
        picture = to_eight_bits(picture)
    with capture.report.stage("write"):
        settings = rendering_settings(None if traditional else depth, patch_size, detail)
        embedded = read_metadata(capture.flat)
        write_picture(output, picture, alpha=alpha, settings=settings, embedded=embedded, compress=compress)
    what = _describe_drawing(traditional, patch_size, blend)
    capture.report.finish(
        {"picture": str(output), **figures},
        camera_sentence(calibration, capture.camera), *depth_sentences(calibration, None if traditional else depth),
        picture_sentence(output, picture, what, capture.report.took), *stated,
    )  # fmt: skip


def _describe_drawing(traditional: bool, patch_size: float | None, blend: bool) -> str:
    if traditional:
        return "a pixel per microlens"
    if patch_size is None:
        return "sharp at every depth"
    return f"of one patch size, {patch_size:g} px{', mixed from all lenses' if blend else ''}"


def _refuse_sharpen(given: str | None) -> None:
    if given is not None:
        raise click.UsageError("--sharpen is gone: pictures get their detail back by --detail natural, the default")
