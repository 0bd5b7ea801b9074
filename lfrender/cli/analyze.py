"""`lfrender analyze`: the depth of every microlens, and the further forms it is written in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfcal.runtime import console
from lfcal.runtime.output_file import check_output

from ..large.size import is_large
from .figures import camera_sentence, capture_figures, depth_sentences
from .inputs import CaptureInput
from .options import (
    INPUT,
    OUTPUT,
    at_most_one,
    capture_command,
    cluster_options,
    connect_cluster,
    edges_option,
    option_errors,
    roi_option,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal import Calibration, Optics

    from ..data.depth_map import DepthMap

__all__ = ["analyze"]

# Suffixes of the forms of depth beside .npz.
_DENSE, _PICTURE, _POINTS = (".tif", ".tiff", ".pfm", ".exr"), (".png",), (".ply", ".pcd")


@capture_command(
    "lfrender analyze flat.png -o depth.npz",
    "lfrender analyze flat.png -c camera.json -o depth.npz --dense depth.tif --picture depth.png",
    "lfrender analyze flat.png -c camera.json -o depth.npz --roi 400 300 900 700",
    "lfrender analyze flat.png -o cloud.ply",
    output=("DEPTH.npz", "Depth map to write; or .tif, .png, .ply: see below.", ".npz"),
    white=True,
    depth=False,
)
@console.grouped(
    "Further forms of the depth",
    click.option(
        "--dense",
        type=OUTPUT,
        metavar="DEPTH.tif|.pfm|.exr",
        help="Patch size [px] of every pixel of the picture, and where a lens has one (second page, or channel).",
    ),
    click.option(
        "--unfilled", is_flag=True, help="Write NaN to --dense where no lens has a depth, not that of places around."
    ),
    click.option("--picture", type=OUTPUT, metavar="DEPTH.png", help="Magnification M in colours, with its legend."),
    click.option(
        "--ply", type=OUTPUT, metavar="CLOUD.ply|.pcd", help="Point cloud: X/D, Y/D, virtual depth D/s, colour."
    ),
)
@console.grouped(
    "Metres",
    click.option(
        "--optics",
        "optics_file",
        type=INPUT,
        metavar="OPTICS.json",
        help="Focal length and distances [mm] of the camera: distances in metres, the point cloud too. By default "
        "those of the camera file, if 'lfcal metric' has measured them.",
    ),
    click.option("--metres", is_flag=True, help="Write --dense as distances in front of the main lens [m]."),
)
@console.grouped(
    "What to analyse",
    edges_option,
    roi_option("Only lenses with their centre between two opposite corners [px]."),
    click.option("--exhaustive", is_flag=True, help="Take no shortcuts: match every lens at every shift."),
)
@cluster_options
def analyze(
    capture: CaptureInput,
    output: Path,
    dense: Path | None,
    unfilled: bool,
    picture: Path | None,
    ply: Path | None,
    optics_file: Path | None,
    metres: bool,
    edges: bool | None,
    roi: tuple[float, float, float, float] | None,
    exhaustive: bool,
    workers: int | None,
    scheduler: str | None,
) -> None:
    """Find the depth of every microlens of FLAT, and its mode.

    Depth is the signed patch size: telescopic where it is positive, binocular where it is negative. The suffix of the
    output chooses its form: .npz holds all that was found, the others are those of --dense, --picture and --ply.
    """
    report = capture.report
    suffix = output.suffix.lower()
    check_output(output, {".npz", *_DENSE, *_PICTURE, *_POINTS}, capture.files)
    for path, suffixes in ((dense, _DENSE), (picture, _PICTURE), (ply, _POINTS)):
        if path is not None:
            check_output(path, suffixes, capture.files)
    dense = output if suffix in _DENSE else dense
    picture = output if suffix in _PICTURE else picture
    ply = output if suffix in _POINTS else ply
    at_most_one("--workers", workers, "--scheduler", scheduler)
    on_cluster = workers or scheduler
    at_most_one("--workers or --scheduler", on_cluster, "--roi", roi, "--ply", ply)
    at_most_one("--edges", edges or None, "--roi", roi, "--workers or --scheduler", on_cluster or None)
    if unfilled and dense is None:
        raise click.UsageError("--unfilled is for --dense")
    optics = None
    if optics_file is not None:
        from lfcal import Optics

        optics = Optics.load(optics_file)
    pixels = None
    if roi is None and ply is None and (on_cluster or (not edges and is_large(capture.flat))):
        from .large import analyze_in_tiles

        with connect_cluster(workers, scheduler, report) as cluster:
            depth, calibration = analyze_in_tiles(capture, not exhaustive, cluster)
    else:
        pixels, calibration = capture.calibrate(capture.read())
        with option_errors(roi):
            depth = capture.analyze(pixels, calibration, skip=not exhaustive, roi=roi, edges=edges)
    optics = optics or calibration.optics
    if metres and optics is None:
        raise click.UsageError("--metres needs optics: a camera file made by 'lfcal metric', or --optics")
    with report.stage("write"):
        if suffix == ".npz":
            depth.save(output)
        _write_depth(depth, pixels, calibration, dense, picture, ply, optics, metres, not unfilled)
    written = dict.fromkeys(str(path) for path in (output, dense, picture, ply) if path is not None)
    report.finish(
        {"depth": str(output), **capture_figures(calibration, depth, optics)},
        camera_sentence(calibration, capture.camera), *depth_sentences(calibration, depth, optics),
        f"{', '.join(written)} in {report.took}.",
    )  # fmt: skip


def _write_depth(
    depth: DepthMap,
    pixels: NDArray[Any] | None,
    calibration: Calibration,
    dense: Path | None,
    picture: Path | None,
    ply: Path | None,
    optics: Optics | None,
    metres: bool,
    fill: bool,
) -> None:
    """Write the further forms of a depth map whose paths are given."""
    if dense:
        from ..data.dense_depth import dense_depth, dense_distance, write_dense

        grid = dense_depth(depth, fill=fill)
        write_dense(dense, grid, dense_distance(grid, optics) if metres and optics is not None else None)
    if picture:
        from ..output.depth_picture import depth_picture
        from ..output.picture import write_picture

        write_picture(picture, depth_picture(depth, calibration.lattice))
    if ply and pixels is not None:
        from ..output.point_cloud import point_cloud, write_points

        write_points(ply, point_cloud(pixels, calibration, depth, optics), metres=optics is not None)
