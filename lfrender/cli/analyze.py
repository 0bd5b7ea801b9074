"""`lfrender analyze`: the depth of every microlens, and the further forms it is written in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfcal.runtime.output_file import check_output

from ..large.size import is_large
from .figures import capture_figures
from .inputs import CaptureInput
from .options import INPUT, OUTPUT, at_most_one, capture_command, cluster_options, connect_cluster, option_errors

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal import Calibration, Optics

    from ..data.depth_map import DepthMap

__all__ = ["analyze"]


@capture_command(
    "lfrender analyze flat.png -o depth.npz",
    "lfrender analyze flat.png -c camera.json -o depth.npz --dense depth.tif --picture depth.png",
    "lfrender analyze flat.png -c camera.json -o depth.npz --roi 400 300 900 700",
    output=("DEPTH.npz", "Depth map to write."),
    white=True,
    depth=False,
)
@click.option(
    "--dense", type=OUTPUT, metavar="DEPTH.tif|.pfm|.exr", help="Patch size [px] of every pixel of the picture."
)
@click.option("--picture", type=OUTPUT, metavar="DEPTH.png", help="Magnification M in colours, with its legend.")
@click.option("--ply", type=OUTPUT, metavar="CLOUD.ply|.pcd", help="Point cloud: X/D, Y/D, virtual depth D/s, colour.")
@click.option(
    "--optics",
    "optics_file",
    type=INPUT,
    metavar="OPTICS.json",
    help="Focal length and distances [mm] of the camera: distances in metres, the point cloud too. By default those "
    "of the camera file, if 'lfcal metric' has measured them.",
)
@click.option("--metres", is_flag=True, help="Write --dense as distances in front of the main lens [m].")
@click.option("--roi", type=float, nargs=4, metavar="X0 Y0 X1 Y1", help="Only lenses with their centre in here [px].")
@click.option("--exhaustive", is_flag=True, help="Take no shortcuts: match every lens at every shift.")
@cluster_options
def analyze(
    capture: CaptureInput,
    output: Path,
    dense: Path | None,
    picture: Path | None,
    ply: Path | None,
    optics_file: Path | None,
    metres: bool,
    roi: tuple[float, float, float, float] | None,
    exhaustive: bool,
    workers: int | None,
    scheduler: str | None,
) -> None:
    """Find for every microlens of FLAT its patch size and whether it is telescopic or binocular."""
    report = capture.report
    check_output(output, {".npz"}, capture.files)
    for path, suffixes in ((dense, {".tif", ".tiff", ".pfm", ".exr"}), (picture, {".png"}), (ply, {".ply", ".pcd"})):
        if path is not None:
            check_output(path, suffixes, capture.files)
    at_most_one("--workers", workers, "--scheduler", scheduler)
    on_cluster = workers or scheduler
    at_most_one("--dark", capture.dark, "--workers or --scheduler", on_cluster or None)
    at_most_one("--workers or --scheduler", on_cluster, "--roi", roi, "--ply", ply)
    optics = None
    if optics_file is not None:
        from lfcal import Optics

        optics = Optics.load(optics_file)
    pixels = None
    if roi is None and ply is None and (on_cluster or (capture.dark is None and is_large(capture.flat))):
        from .large import analyze_in_tiles

        with connect_cluster(workers, scheduler, report) as cluster:
            depth, calibration = analyze_in_tiles(capture, not exhaustive, cluster)
    else:
        pixels, calibration = capture.calibrate(capture.read("lfrender.depth.analyze"))
        with option_errors(roi):
            depth = capture.analyze(pixels, calibration, skip=not exhaustive, roi=roi)
    optics = optics or calibration.optics
    if metres and optics is None:
        raise click.UsageError("--metres needs optics: a camera file made by 'lfcal metric', or --optics")
    with report.stage("write"):
        depth.save(output)
        _write_depth(depth, pixels, calibration, dense, picture, ply, optics, metres)
    report.finish({"depth": str(output), **capture_figures(calibration, depth, optics)})


def _write_depth(
    depth: DepthMap,
    pixels: NDArray[Any] | None,
    calibration: Calibration,
    dense: Path | None,
    picture: Path | None,
    ply: Path | None,
    optics: Optics | None,
    metres: bool,
) -> None:
    """Write the further forms of a depth map whose paths are given."""
    if dense:
        from ..data.dense_depth import dense_depth, dense_distance, write_dense

        grid = dense_depth(depth)
        write_dense(dense, grid, dense_distance(grid, optics) if metres and optics is not None else None)
    if picture:
        from ..output.depth_picture import depth_picture
        from ..output.picture import write_picture

        write_picture(picture, depth_picture(depth, calibration.lattice))
    if ply and pixels is not None:
        from ..output.point_cloud import point_cloud, write_points

        write_points(ply, point_cloud(pixels, calibration, depth, optics), metres=optics is not None)
