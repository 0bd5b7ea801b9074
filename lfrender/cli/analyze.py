"""`lfrender analyze`: the depth of every microlens, and the further forms it is written in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lfcal.runtime.output_file import check_output

from .inputs import CaptureInput, is_large
from .options import at_most_one, capture_command, connect_cluster, option_errors
from .printed import figures
from .printed.results import AnalyzeResult

if TYPE_CHECKING:
    from lfcal import Calibration, Optics

__all__ = ["analyze"]

# Suffixes of the forms of depth beside .npz, by the option for each; an output with that of several
# is the first one.
_FORMS = {
    "dense": (".tif", ".tiff", ".pfm", ".exr"),
    "picture": (".png",),
    "uncertainty": (".png",),
    "ply": (".ply", ".pcd"),
    "mesh": (".glb", ".ply"),
}


@capture_command(
    AnalyzeResult,
    "lfrender analyze flat.png -o depth.npz",
    "lfrender analyze flat.png -c camera.json -o depth.npz --dense depth.tif --picture depth.png",
    "lfrender analyze flat.png -c camera.json -o depth.npz --roi 400 300 900 700",
    "lfrender analyze flat.png -o cloud.ply",
    "lfrender analyze flat.png -o scene.glb",
    output=("DEPTH.npz", "Depth map to write; or .tif, .png, .ply, .glb: see below.", ".npz"),
    refused={"depth_file": "the depth is what this command finds"},
    own={
        "Further forms of the depth": "dense unfilled picture uncertainty ply mesh",
        "Metres": "optics metres",
        "What to analyse": "edges exhaustive",
        "Several processes": "workers scheduler",
    },
)
def analyze(capture: CaptureInput, given: Any) -> None:
    """Find the depth of every microlens of FLAT, and its mode.

    Depth is the signed patch size: telescopic where it is positive, binocular where it is negative.
    The suffix of the output chooses its form: .npz holds all that was found, others are those of
    --dense, --picture, --ply and --mesh.
    """
    from lfcal import Optics

    from ..data.dense_depth import check_dense_file
    from ..output.point_cloud import check_mesh_file

    report = capture.report
    roi = capture.roi
    output = given.output
    edges = given.edges
    check_output(output, {".npz"}.union(*_FORMS.values()))
    forms: dict[str, Path] = {}
    for name, suffixes in _FORMS.items():
        if (path := getattr(given, name)) is not None:
            check_output(path, suffixes)
            forms[name] = path
        own = output.suffix.lower() in suffixes and output not in forms.values()
        if own and name != "uncertainty":
            at_most_one("--output", output, f"--{name}", path)
            forms[name] = output
    if "dense" in forms:
        check_dense_file(forms["dense"])
    if "mesh" in forms:
        check_mesh_file(forms["mesh"])
    on_cluster = given.workers or given.scheduler
    whole = {f"--{name}": forms[name] for name in ("ply", "mesh") if name in forms}
    for option, path in whole.items():
        at_most_one("--workers or --scheduler", on_cluster, "--roi", roi, option, path)
    at_most_one("--edges", edges or None, "--roi", roi, "--workers or --scheduler", on_cluster)
    if given.unfilled and "dense" not in forms:
        raise click.UsageError("--unfilled is for --dense")
    given.optics = given.optics and Optics.load(given.optics)
    pixels = None
    if roi is None and not whole and (on_cluster or (not edges and is_large(capture.flat))):
        with connect_cluster(given, report) as cluster, capture.open_parts() as source:
            calibration = capture.calibrate_parts(source)
            optics = _choose_optics(given, calibration)
            with report.stage("analyze"):
                depth = capture.analyze_parts(
                    source, calibration, cluster, skip=not given.exhaustive
                )
    else:
        pixels, calibration = capture.calibrate(capture.read())
        optics = _choose_optics(given, calibration)
        with option_errors():
            depth = capture.analyze(
                pixels, calibration, skip=not given.exhaustive, roi=roi, edges=edges
            )
    found = {"depth": str(output), **figures.capture_figures(calibration, depth, optics)}
    closing = []
    with report.stage("write"):
        if output.suffix.lower() == ".npz":
            depth.save(output)
        if "dense" in forms:
            from ..data.dense_depth import dense_depth, dense_distance, write_dense

            grid = dense_depth(depth, fill=not given.unfilled)
            distance = None
            if given.metres and optics is not None:
                distance = dense_distance(grid, optics)
            write_dense(forms["dense"], grid, distance)
        if "picture" in forms:
            from ..data.depth_order import depth_limits, describe_scale, name_ends
            from ..output.depth_picture import add_legend, depth_picture
            from ..output.picture import write_picture

            limits = depth_limits(depth)
            found["colours"] = list(limits)
            shown = add_legend(depth_picture(depth), name_ends(limits))
            write_picture(forms["picture"], shown, settings={"far_near": list(limits)})
            closing.append(f"{forms['picture']}: {describe_scale(limits)}.")
        if "uncertainty" in forms:
            from ..output.depth_picture import ERROR_SCALE, add_legend, uncertainty_picture
            from ..output.picture import write_picture

            shown, errors = uncertainty_picture(depth)
            sure, unsure = (f"{error:.2g} px" for error in errors)
            shown = add_legend(shown, (sure, unsure), ERROR_SCALE)
            write_picture(forms["uncertainty"], shown, settings={"standard_error": list(errors)})
            closing.append(
                f"{forms['uncertainty']}: standard error of the patch size from {sure} (dark) to "
                f"{unsure} (light), logarithmic; grey: no depth."
            )
        if whole and pixels is not None:
            from ..output.point_cloud import mesh, point_cloud, write_mesh, write_points

            if "ply" in forms:
                write_points(
                    forms["ply"],
                    point_cloud(pixels, calibration, depth, optics),
                    metres=optics is not None,
                )
            if "mesh" in forms:
                surface = mesh(pixels, calibration, depth, optics)
                write_mesh(forms["mesh"], surface)
                closing.append(
                    f"{forms['mesh']}: {len(surface.faces):,} triangles; "
                    f"{surface.metadata['axes']}."
                )
    written = dict.fromkeys(map(str, (output, *forms.values())))
    sentences = capture.sentences(calibration, depth, optics)
    report.finish(found, *sentences, f"{', '.join(written)} in {report.took}.", *closing)


def _choose_optics(given: Any, calibration: Calibration) -> Optics | None:
    """The optics of the option, or of the camera; an error if metres need them."""
    optics: Optics | None = given.optics or calibration.optics
    if given.metres and optics is None:
        raise click.UsageError(
            "--metres needs optics: a camera file made by 'lfcal metric', or --optics"
        )
    return optics
