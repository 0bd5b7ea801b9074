"""Commands on camera files: show what is in one, compare two, convert one."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any

import click

from ..runtime import command_line as cl
from ..runtime.output_file import check_output
from .figures import describe, summarise, tell_all
from .inputs import RESULTS, SIZE_OPTIONS, read_camera, read_image

__all__ = ["compare", "convert", "info"]


@cl.command("lfcal info camera.json", "lfcal info calibration.xml --image flat.png")
@click.argument("camera", type=cl.INPUT)
@cl.with_options(*SIZE_OPTIONS)
@cl.report_options(RESULTS["camera"])
def info(report: cl.Report, given: Any) -> None:
    """Show what is in the camera file CAMERA, and whether it is the camera of --image."""
    pixels, size = read_image(given)
    camera = read_camera(given.camera, size)
    if pixels is not None:
        from .. import check_camera

        warnings = check_camera(pixels, camera).warnings
        camera = replace(camera, warnings=(*camera.warnings, *warnings))
    report.finish({"camera": str(given.camera), **describe(camera)}, *tell_all(camera))


@cl.command("lfcal compare monday.json friday.json")
@click.argument("a", type=cl.INPUT)
@click.argument("b", type=cl.INPUT)
@cl.with_options(*SIZE_OPTIONS)
@cl.report_options(RESULTS["compare"])
def compare(report: cl.Report, given: Any) -> None:
    """Tell how the microimage centres of cameras A and B differ.

    All differences are B minus A, in pixels.
    """
    from .. import CameraFileError, load
    from .. import compare as run
    from ..display.compare import REGIONS

    paths = (given.a, given.b)
    _, size = read_image(given)
    for path in paths:
        # A published file has none.
        with suppress(CameraFileError):
            size = size or load(path).image_size
    cameras = [read_camera(path, size) for path in paths]
    found = run(*cameras)
    field = dict(zip(REGIONS, found.field.reshape(-1, 2), strict=True))
    x, y = found.mean_shift
    parts = "; ".join(f"{name} x {dx:+.4f}, y {dy:+.4f}" for name, (dx, dy) in field.items())
    warnings = [
        f"{path}: {text}"
        for path, camera in zip(paths, cameras, strict=True)
        for text in camera.warnings
    ]
    report.finish(
        {
            "a": str(given.a),
            "b": str(given.b),
            "rms": found.rms,
            "max": found.max,
            "mean_shift": found.mean_shift,
            "scale": found.scale,
            "rotation_degrees": found.rotation_degrees,
            "field": field,
            "warnings": warnings,
        },
        f"The centres of {given.b} lie {found.rms:.4f} px (RMS) from those of {given.a}, at most "
        f"{found.max:.4f} px.",
        f"They are shifted by x {x:+.4f}, y {y:+.4f} px on average, turned by "
        f"{found.rotation_degrees:+.5f} degrees (clockwise), and their pitch is {found.scale:.7f} "
        "times as large.",
        f"Shift in each part of the flat [px]: {parts}.",
    )


@cl.command(
    "lfcal convert camera.json -o calibration.xml",
    "lfcal convert calibration.xml --image flat.png -o camera.json",
    "lfcal convert camera.json --image flat.png -o camera.cfg",
    "lfcal convert centres.csv --image white.png -o camera.json",
)
@click.argument("camera", type=cl.INPUT)
@cl.output_option("FILE", ".xml, .cfg, .csv or .json to write.")
@cl.option(
    "--mode",
    click.Choice(["telescopic", "binocular"]),
    "Mode of the captures, for a .cfg file.  [default: that of --image or of the lens types]",
)
@cl.option(
    "--y-up/--y-down",
    None,
    "Where y of a table of centres points.  [default: as --image shows, else down]",
    default=None,
)
@cl.with_options(*SIZE_OPTIONS)
@cl.report_options(RESULTS["convert"])
def convert(report: cl.Report, given: Any) -> None:
    """Write CAMERA in the format of another program, or the reverse.

    The suffix of the output chooses the format. CAMERA may be a maker's table of centres: lines of
    x, y, radius and type, or with a header that names the columns.
    """
    from ..camera_files.read_write import FORMATS
    from ..camera_files.read_write import convert as run

    output = given.output
    mode = given.mode
    check_output(output, FORMATS)
    pixels, size = read_image(given)
    camera = read_camera(given.camera, size)
    up = read_camera(given.camera, size, True)
    told = ""
    if camera == up and given.y_up is not None:
        raise click.UsageError("--y-up and --y-down are for tables of centres")
    if camera != up and given.y_up is None and pixels is not None:
        from ..display.camera_check import choose_orientation

        camera = choose_orientation(camera, up, pixels)
    elif camera != up and given.y_up is None:
        told = "; y was taken to point down: --image shows whether it does"
    elif given.y_up:
        camera = up
    if mode is None and pixels is not None and output.suffix.lower() == ".cfg":
        from ..lens_types.coarse_disparity import find_scene_mode

        mode = find_scene_mode(pixels, camera.lattice)
    run(camera, output, mode=mode)
    if camera.source == "published" and camera.lenses_used:
        told = f", {camera.residual_rms:.3f} px (RMS) from the centres of the table{told}"
    report.finish(
        {"written": str(output), **describe(camera)},
        *summarise(camera),
        f"{output} is written{told}.",
    )
