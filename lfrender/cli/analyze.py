"""`lfrender analyze`: the depth of every microlens, and the further forms it is written in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from lfcal import LightFieldError
from lfcal.runtime import console
from lfcal.runtime.output_file import check_output

from ..runtime.background_imports import import_in_background
from .figures import camera_figures, depth_figures, distance_figures
from .inputs import analysed, camera_of, in_colour, read_optics
from .options import CAMERA, INPUT, OUTPUT, WITHOUT_CAMERA, at_most_one, cluster_options, flat_argument, preset_option

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfcal import Calibration

    from ..data.depth_map import DepthMap
    from ..data.optics import Optics

__all__ = ["analyze"]


@click.command(
    epilog=console.help_examples(
        "lfrender analyze flat.png -o depth.npz",
        "lfrender analyze flat.png -c camera.json -o depth.npz --dense depth.tif --picture depth.png",
        "lfrender analyze flat.png -c camera.json -o depth.npz --roi 400 300 900 700",
    )
)
@flat_argument
@click.option("-o", "--output", type=OUTPUT, required=True, metavar="DEPTH.npz", help="Depth map to write.")
@click.option("-c", "--camera", type=INPUT, help=CAMERA + WITHOUT_CAMERA)
@click.option("--white", type=INPUT, help="Calibrate from this white image of the same camera.")
@click.option("--dense", type=OUTPUT, metavar="DEPTH.tif|.pfm", help="Patch size [px] of every pixel of the picture.")
@click.option("--picture", type=OUTPUT, metavar="DEPTH.png", help="Magnification M in colours, with its legend.")
@click.option("--ply", type=OUTPUT, metavar="CLOUD.ply", help="Point cloud: X/D, Y/D, virtual depth D/s, colour.")
@click.option(
    "--optics",
    "optics_file",
    type=INPUT,
    metavar="OPTICS.json",
    help="Focal length and distances [mm] of the camera: distances in metres, the point cloud too.",
)
@click.option("--roi", type=float, nargs=4, metavar="X0 Y0 X1 Y1", help="Only lenses with their centre in here [px].")
@click.option("--exhaustive", is_flag=True, help="Take no shortcuts: match every lens at every shift.")
@cluster_options
@preset_option
@console.report_options
def analyze(
    flat: Path,
    output: Path,
    camera: Path | None,
    white: Path | None,
    dense: Path | None,
    picture: Path | None,
    ply: Path | None,
    optics_file: Path | None,
    roi: tuple[float, float, float, float] | None,
    exhaustive: bool,
    workers: int | None,
    scheduler: str | None,
    preset: str,
    as_json: bool,
    quiet: bool,
) -> None:
    """Find for every microlens of FLAT its patch size and whether it is telescopic or binocular."""
    report = console.Report(as_json, quiet)
    at_most_one("--camera", camera, "--white", white)
    check_output(output, {".npz"}, [flat, camera, white])
    for path, endings in ((dense, {".tif", ".tiff", ".pfm"}), (picture, {".png"}), (ply, {".ply"})):
        if path is not None:
            check_output(path, endings, [flat, camera, white])
    at_most_one("--workers", workers, "--scheduler", scheduler)
    cluster = workers or scheduler
    at_most_one("--workers or --scheduler", cluster, "--roi", roi, "--ply", ply)
    if roi is None and ply is None:
        from . import large as large_cli

        if cluster or large_cli.is_large(flat):
            optics = read_optics(optics_file)
            on = large_cli.Cluster(workers, scheduler)
            depth, calibration = large_cli.analyze(report, flat, camera, white, output, preset, not exhaustive, on)
            with report.stage("write"):
                _write_depth(depth, None, calibration, dense, picture, None, optics)
            figures = {**camera_figures(calibration, depth), **depth_figures(depth), **distance_figures(depth, optics)}
            report.finish({"depth": str(output), **figures})
            return
    import_in_background("lfrender.depth.analyze")
    with report.stage("read"):
        from lfcal import read_flat

        optics = read_optics(optics_file)
        pixels = read_flat(flat)
    with report.stage("calibrate"):
        calibration = camera_of(report, flat, pixels, camera, white, None)
        pixels = in_colour(pixels, calibration)
    with report.stage("analyze"):
        try:
            depth = analysed(report, pixels, calibration, preset, skip=not exhaustive, roi=roi)
        except LightFieldError:
            raise
        except ValueError as error:
            if roi is None:
                raise
            raise click.UsageError(str(error)) from error
    with report.stage("write"):
        depth.save(output)
        _write_depth(depth, pixels, calibration, dense, picture, ply, optics)
    figures = {**camera_figures(calibration, depth), **depth_figures(depth), **distance_figures(depth, optics)}
    report.finish({"depth": str(output), **figures})


def _write_depth(
    depth: DepthMap,
    pixels: NDArray[np.generic] | None,
    calibration: Calibration,
    dense: Path | None,
    picture: Path | None,
    ply: Path | None,
    optics: Optics | None,
) -> None:
    """The further forms of a depth map that were asked for."""
    if dense:
        from ..data.dense_depth import dense_depth, write_dense

        write_dense(dense, dense_depth(depth))
    if picture:
        from ..output.depth_picture import depth_picture
        from ..output.picture import write_picture

        write_picture(picture, depth_picture(depth, calibration.lattice))
    if ply and pixels is not None:
        from ..output.point_cloud import point_cloud, write_points

        write_points(ply, point_cloud(pixels, calibration, depth, optics), metres=optics is not None)
