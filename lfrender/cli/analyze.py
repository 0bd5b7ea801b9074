"""`lfrender analyze`: the depth of every microlens, and the further forms it is written in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfcal.runtime.output_file import check_output

from . import figures
from .inputs import CaptureInput, is_large
from .options import at_most_one, capture_command, connect_cluster, option_errors

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
    refused={"depth_file": "the depth is what this command finds"},
    own={
        "Further forms of the depth": "dense unfilled picture ply",
        "Metres": "optics metres",
        "What to analyse": "edges exhaustive",
        "Several processes": "workers scheduler",
    },
)
def analyze(capture: CaptureInput, given: Any) -> None:
    """Find the depth of every microlens of FLAT, and its mode.

    Depth is the signed patch size: telescopic where it is positive, binocular where it is negative. The suffix of the
    output chooses its form: .npz holds all that was found, the others are those of --dense, --picture and --ply.
    """
    report, roi, output, edges = capture.report, capture.roi, given.output, given.edges
    suffix, on_cluster = output.suffix.lower(), given.workers or given.scheduler
    check_output(output, {".npz", *_DENSE, *_PICTURE, *_POINTS}, capture.files)
    for path, suffixes in ((given.dense, _DENSE), (given.picture, _PICTURE), (given.ply, _POINTS)):
        if path is not None:
            check_output(path, suffixes, capture.files)
    dense = output if suffix in _DENSE else given.dense
    picture = output if suffix in _PICTURE else given.picture
    ply = output if suffix in _POINTS else given.ply
    at_most_one("--workers", given.workers, "--scheduler", given.scheduler)
    at_most_one("--workers or --scheduler", on_cluster, "--roi", roi, "--ply", ply)
    at_most_one("--edges", edges or None, "--roi", roi, "--workers or --scheduler", on_cluster)
    if given.unfilled and dense is None:
        raise click.UsageError("--unfilled is for --dense")
    optics = None
    if given.optics is not None:
        from lfcal import Optics

        optics = Optics.load(given.optics)
    pixels = None
    if roi is None and ply is None and (on_cluster or (not edges and is_large(capture.flat))):
        from .large import analyze_in_tiles

        with connect_cluster(given.workers, given.scheduler, report) as cluster:
            depth, calibration = analyze_in_tiles(capture, not given.exhaustive, cluster)
    else:
        pixels, calibration = capture.calibrate(capture.read())
        with option_errors(roi):
            depth = capture.analyze(pixels, calibration, skip=not given.exhaustive, roi=roi, edges=edges)
    optics = optics or calibration.optics
    if given.metres and optics is None:
        raise click.UsageError("--metres needs optics: a camera file made by 'lfcal metric', or --optics")
    with report.stage("write"):
        if suffix == ".npz":
            depth.save(output)
        files = dense, picture, ply
        scale = _write_depth(depth, pixels, calibration, files, optics, given.metres, not given.unfilled)
    written = dict.fromkeys(str(path) for path in (output, dense, picture, ply) if path is not None)
    report.finish(
        {"depth": str(output), **figures.capture_figures(calibration, depth, optics), **scale},
        figures.camera_sentence(calibration, capture.camera), *figures.depth_sentences(calibration, depth, optics),
        f"{', '.join(written)} in {report.took}.", *_scale_sentence(picture, scale),
    )  # fmt: skip


def _scale_sentence(picture: Path | None, scale: dict[str, list[float]]) -> list[str]:
    if not scale:
        return []
    low, high = scale["colours"]
    return [f"{picture}: magnification M from {low:.1f} (blue) to {high:.1f} (red), logarithmic; grey: unresolved."]


def _write_depth(
    depth: DepthMap,
    pixels: NDArray[Any] | None,
    calibration: Calibration,
    files: tuple[Path | None, Path | None, Path | None],
    optics: Optics | None,
    metres: bool,
    fill: bool,
) -> dict[str, list[float]]:
    """Write the further forms of a depth map whose paths are given; returns the ends of the colours of the picture."""
    dense, picture, ply = files
    scale: dict[str, list[float]] = {}
    if dense:
        from ..data.dense_depth import dense_depth, dense_distance, write_dense

        grid = dense_depth(depth, fill=fill)
        write_dense(dense, grid, dense_distance(grid, optics) if metres and optics is not None else None)
    if picture:
        from ..output.depth_picture import depth_picture, magnification_limits
        from ..output.picture import write_picture

        scale = {"colours": list(magnification_limits(depth.magnification))}
        write_picture(picture, depth_picture(depth, calibration.lattice), settings={"magnification": scale["colours"]})
    if ply and pixels is not None:
        from ..output.point_cloud import point_cloud, write_points

        write_points(ply, point_cloud(pixels, calibration, depth, optics), metres=optics is not None)
    return scale
