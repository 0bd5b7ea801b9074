"""`lfrender render`: one picture of a flat, sharp everywhere or drawn with one patch size."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from ..runtime.types import Entries
from . import figures
from .inputs import CaptureInput, is_large
from .options import capture_command, connect_cluster, option_errors

if TYPE_CHECKING:
    from pathlib import Path

    from lfcal import Calibration, FlatSource
    from lfcal.runtime.arrays import Array

    from ..data.depth_map import DepthMap

__all__ = ["render"]


@capture_command(
    "render",
    "lfrender render flat.png -o picture.tif",
    "lfrender render flat.png -c camera.json --depth depth.npz --scale 12 -o picture.png",
    "lfrender render flat.png --white white.png --patch-size -8.5 -o binocular.png",
    output=("PICTURE", "Picture to write: .tif, .png, .jpg, ...", ".png"),
    own={
        "What to draw": "patch_size blend traditional scale resize edges detail",
        "How to write it": "eight_bits exposure tone white_balance quality alpha compress tile",
        "Several processes": "workers scheduler",
    },
    exclusive=(
        "depth_file patch_size traditional",
        "scale traditional",
        "resize traditional",
        "resize roi",
        "detail patch_size traditional",
        "roi traditional tile",
        "workers roi traditional",
        "scheduler roi traditional",
        "edges depth_file patch_size traditional",
        "edges roi",
    ),
)
def render(capture: CaptureInput, given: Any) -> None:
    """Draw FLAT as one picture that is sharp at every depth.

    Without --depth, --patch-size and --traditional the depth is analysed first. A flat of more than
    100 MB, as TIFF or Zarr, is read and drawn in tiles; the finished tiles of an interrupted run
    are used by the next one.
    """
    in_tiles = _check(capture, given)
    if given.scale is None and given.patch_size is None and capture.recording is not None:
        given.scale = capture.recording.scale  # that of the live pictures
    drawing = {
        "patch_size": given.patch_size,
        "scale": given.scale,
        "detail": given.detail,
        "blend": given.blend or None,
    }
    stored = {"alpha": given.alpha, "compress": given.compress}
    if in_tiles:
        with connect_cluster(given, capture.report) as cluster:
            options = {**stored, **drawing, "quality": given.quality, "tile": given.tile}
            _render_in_tiles(capture, given, cluster, **options)
        return
    from ..output.formats import check_format

    output = given.output
    patch_size = given.patch_size
    traditional = given.traditional
    pixels = capture.read()
    check_format(output, "picture", dtype=pixels.dtype)
    pixels, calibration = capture.calibrate(pixels)
    depth = None
    if not traditional and patch_size is None:
        depth = _find_depth(capture, pixels, calibration, given.edges)
    with capture.report.stage("render"), option_errors():
        from .. import render as run
        from .. import traditional as run_traditional
        from ..output.views import resize_view, scale_for_size
        from ..rendering.traditional import TOO_LITTLE, find_depth_problem

        drawing["scale"] = scale_for_size(calibration, given.resize, given.scale)
        chosen = drawing["scale"] or capture.roi
        if depth is not None and not chosen and find_depth_problem(depth):
            traditional = True
            capture.report.warn(TOO_LITTLE.format("--scale"))
        if traditional:
            picture = run_traditional(pixels, calibration)
        else:
            picture = run(pixels, calibration, depth, roi=capture.roi, **drawing)
        picture = resize_view(picture, given.resize)
    drawn = None if traditional else depth
    settings = figures.rendering_settings(drawn, patch_size, given.detail)
    _, stated = capture.write(given, [picture], [settings], **stored)
    what = "sharp at every depth"
    if traditional:
        what = "a pixel per microlens"
    if patch_size is not None:
        what = f"of one patch size, {patch_size:g} px"
    if given.blend:
        what += ", mixed from all lenses"
    found = {"picture": output, **figures.picture_figures(picture)}
    closing = figures.picture_sentence(output, picture, what, capture.report.took)
    capture.conclude(found, calibration, depth, closing, *stated)


def _render_in_tiles(capture: CaptureInput, given: Any, cluster: Entries, **options: Any) -> None:
    """Calibrate, analyse and render in tiles; what is finished is kept until the end."""
    from lfcal.runtime.output_file import claim

    from .. import render_large
    from ..large.render import LargeOptions, check_large_picture

    report = capture.report
    output = given.output
    depth = None
    with capture.open_parts() as source:
        check_large_picture(output, source.dtype, alpha=given.alpha, quality=given.quality)
        # From the analysis on: its result is kept beside the output too.
        with claim(output):
            calibration = capture.calibrate_parts(source)
            if given.patch_size is None:
                with report.stage("analyze"):
                    depth = _find_depth_in_tiles(capture, source, calibration, output, cluster)
            about = figures.rendering_settings(depth, given.patch_size, given.detail)
            chosen = LargeOptions(settings=about, **options)
            with report.stage("render"), report.progress("tiles") as step, option_errors():
                made = render_large(
                    source, output, calibration, depth, chosen, progress=step, **cluster
                )
    width, height = made.size
    tiles = f"{made.tiles} tiles"
    if made.kept:
        tiles += f", {made.kept} of them kept from an earlier run"
    found = {name: getattr(made, name) for name in ("size", "scale", "valid", "affine", "tiles")}
    found |= {"picture": output, "tiles_kept": made.kept}
    closing = f"{output}: {width} x {height} px in {tiles}, in {report.took}."
    capture.conclude(found, calibration, depth, closing)


def _find_depth_in_tiles(
    capture: CaptureInput,
    source: FlatSource,
    calibration: Calibration,
    output: Path,
    cluster: Entries,
) -> DepthMap:
    """The depth of the file, or of the flat; kept beside the output until that is complete."""
    from ..data.depth_map import DepthMap
    from ..output.resume import Checkpoint

    if capture.depth_file is not None:
        raw = calibration.mosaic is not None and len(source.shape) == 2
        return capture.read_depth(None if raw else source)
    about = [capture.page, capture.chosen_preset, calibration.to_dict()]
    checkpoint = Checkpoint(output, "depth", capture.flat, capture.dark, about)
    file = checkpoint.folder / "depth.npz"
    if not (checkpoint.found and file.exists()):
        found = capture.analyze_parts(source, calibration, cluster)
        checkpoint.open()
        found.save(file)
        checkpoint.keep()
    # Always from the file: later results do not depend on whether a run was interrupted.
    return DepthMap.load(file)


def _check(capture: CaptureInput, given: Any) -> bool:
    """Refuse options that make no sense together; whether the picture is drawn in tiles."""
    from ..large.render import check_large_picture
    from ..output.formats import check_format, is_ome_name

    if given.blend and given.patch_size is None:
        raise click.UsageError("--blend needs --patch-size")
    needed = {"alpha": given.alpha, "quality": given.quality}
    # A plain Zarr array is written in tiles however small it is, OME-Zarr is not.
    plain = given.output.suffix.lower() == ".zarr" and not is_ome_name(given.output)
    wanted = given.workers or given.scheduler or given.tile or plain
    if given.traditional or capture.roi or not (wanted or is_large(capture.flat)):
        check_format(given.output, "picture", **needed)
        return False
    if given.edges:
        raise click.UsageError(
            "--edges is for flats that are analysed as a whole: leave it out here"
        )
    changes = {
        "--8bit": given.eight_bits,
        "--exposure": given.exposure,
        "--tone": given.tone != "auto",
        "--white-balance": given.white_balance != "auto",
        "--resize": given.resize,
    }
    for option, value in changes.items():
        if value:
            raise click.UsageError(
                f"{option} is for flats that are drawn as a whole: write the pixels as they are"
            )
    check_large_picture(given.output, None, **needed)
    return True


def _find_depth(
    capture: CaptureInput, pixels: Array, calibration: Calibration, edges: bool | None
) -> DepthMap:
    from ..rendering.render import expand_roi

    with option_errors():
        needed = capture.roi and expand_roi(capture.roi, calibration)
    return capture.analyze(pixels, calibration, roi=needed, edges=edges)
