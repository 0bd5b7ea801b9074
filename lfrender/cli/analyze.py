"""`lfrender analyze`: the depth of every microlens, and the further forms it is written in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..runtime.types import Entries
from .inputs import CaptureInput, is_large
from .option_table import DEPTH_FORMS
from .options import capture_command, connect_cluster, option_errors, refuse_together

if TYPE_CHECKING:
    from lfcal import Calibration, Optics

    from ..data.depth_map import DepthMap

__all__ = ["analyze"]

_CLUSTER = ("workers", "scheduler")
# Forms of flats that are analysed as a whole.
_WHOLE = ("ply", "mesh")


@capture_command(
    "analyze",
    "lfrender analyze flat.png -o depth.npz",
    "lfrender analyze flat.png -c camera.json -o depth.npz --dense depth.tif --picture depth.png",
    "lfrender analyze flat.png -c camera.json -o depth.npz --roi 400 300 900 700",
    "lfrender analyze flat.png -o cloud.ply --roi 400 300 900 700",
    "lfrender analyze flat.png -o scene.glb",
    output=(
        "DEPTH.npz",
        "Depth map to write; or .tif, .png, .ply, .glb: see below.",
        ".npz",
        "",
        {".npz"}.union(*DEPTH_FORMS.values()),
    ),
    refused={"depth_file": "the depth is what this command finds"},
    own={
        "Further forms of the depth": "dense unfilled picture uncertainty ply mesh",
        "Metres": "optics metres",
        "What to analyse": "edges exhaustive",
        "Several processes": "workers scheduler",
    },
    exclusive=("edges roi workers", "edges scheduler", "roi scheduler"),
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
    output = given.output
    forms = _choose_forms(given)
    if forms["dense"]:
        check_dense_file(forms["dense"])
    if forms["mesh"]:
        check_mesh_file(forms["mesh"])
    values = {**vars(given), **forms, "roi": capture.roi}
    refuse_together(values, *(f"{name} {form}" for name in _CLUSTER for form in _WHOLE))
    if given.unfilled and not forms["dense"]:
        raise click.UsageError("--unfilled is for --dense")
    given.optics = given.optics and Optics.load(given.optics)
    whole = capture.roi or forms["ply"] or forms["mesh"]
    large = given.workers or given.scheduler or (not given.edges and is_large(capture.flat))
    options: Entries = {"skip": not given.exhaustive}
    pixels = None
    if large and not whole:
        with connect_cluster(given, report) as cluster, capture.open_parts() as source:
            calibration = capture.calibrate_parts(source)
            optics = _choose_optics(given, calibration)
            with report.stage("analyze"):
                depth = capture.analyze_parts(source, calibration, cluster, **options)
    else:
        pixels, calibration = capture.calibrate(capture.read())
        optics = _choose_optics(given, calibration)
        options |= {"roi": capture.roi, "edges": given.edges}
        with option_errors():
            depth = capture.analyze(pixels, calibration, **options)
    found: Entries = {"depth": output}
    closing = []
    with report.stage("write"):
        if output.suffix.lower() == ".npz":
            depth.save(output)
        if forms["dense"]:
            _write_dense(forms["dense"], depth, given, optics)
        for name in ("picture", "uncertainty"):
            path = forms[name]
            if path is not None:
                closing.append(_write_colours(path, name, depth, found))
        if whole and pixels is not None:
            from ..output.point_cloud import mesh, point_cloud, write_mesh, write_points

            if forms["ply"]:
                points = point_cloud(pixels, calibration, depth, optics)
                write_points(forms["ply"], points, metres=optics is not None)
            if forms["mesh"]:
                surface = mesh(pixels, calibration, depth, optics)
                write_mesh(forms["mesh"], surface)
                about = f"{len(surface.faces):,} triangles; {surface.metadata['axes']}"
                closing.append(f"{forms['mesh']}: {about}.")
    written = dict.fromkeys(str(path) for path in (output, *forms.values()) if path)
    closing.insert(0, f"{', '.join(written)} in {report.took}.")
    capture.conclude(found, calibration, depth, *closing, optics=optics)


def _choose_forms(given: Any) -> dict[str, Path | None]:
    """The files of the further forms; that of the output is the first with its suffix."""
    forms: dict[str, Path | None] = {name: getattr(given, name) for name in DEPTH_FORMS}
    suffix = given.output.suffix.lower()
    for name in (name for name, suffixes in DEPTH_FORMS.items() if suffix in suffixes):
        if forms[name]:
            raise click.UsageError(f"--output and --{name} exclude each other")
        forms[name] = given.output
        break
    return forms


def _write_dense(path: Path, depth: DepthMap, given: Any, optics: Optics | None) -> None:
    """Write the patch size of every pixel, or its distance."""
    from ..data.dense_depth import dense_depth, dense_distance, write_dense

    grid = dense_depth(depth, fill=not given.unfilled)
    distance = None
    if given.metres and optics is not None:
        distance = dense_distance(grid, optics)
    write_dense(path, grid, distance)


def _write_colours(path: Path, name: str, depth: DepthMap, found: Entries) -> str:
    """Write depth or its errors in colours; returns a sentence about the scale."""
    from ..data.depth_order import depth_limits, describe_scale, name_ends
    from ..output.depth_picture import ERROR_SCALE, add_legend, depth_picture, uncertainty_picture
    from ..output.picture import write_picture

    if name == "picture":
        limits = depth_limits(depth)
        found["colours"] = limits
        shown = add_legend(depth_picture(depth), name_ends(limits))
        write_picture(path, shown, settings={"far_near": limits})
        return f"{path}: {describe_scale(limits)}."
    shown, errors = uncertainty_picture(depth)
    sure, unsure = (f"{error:.2g} px" for error in errors)
    shown = add_legend(shown, (sure, unsure), ERROR_SCALE)
    write_picture(path, shown, settings={"standard_error": errors})
    return (
        f"{path}: standard error of the patch size from {sure} (dark) to {unsure} (light), "
        "logarithmic; grey: no depth."
    )


def _choose_optics(given: Any, calibration: Calibration) -> Optics | None:
    """The optics of the option, or of the camera; an error if metres need them."""
    optics: Optics | None = given.optics or calibration.optics
    if given.metres and optics is None:
        raise click.UsageError(
            "--metres needs optics: a camera file made by 'lfcal metric', or --optics"
        )
    return optics
