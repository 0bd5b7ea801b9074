"""Commands that draw a flat with its camera: circles over it, or the flat evenly lit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import click

from ..runtime import command_line as cl
from ..runtime.image_formats import TIFF_SUFFIXES
from ..runtime.output_file import atomic_write
from .figures import describe, summarise
from .inputs import RESULTS, read_camera, read_flats

__all__ = ["flatten", "show"]


@cl.command("lfcal show camera.json --image white.png -o show.png")
@click.argument("camera", type=cl.INPUT)
@cl.option("--image", cl.INPUT, "A white image or scene capture of that camera.", required=True)
@cl.option(*cl.DARK)
@cl.output_option("SHOW.png", "Picture to write.", suffixes=(".png",))
@cl.report_options(RESULTS["show"])
def show(report: cl.Report, given: Any) -> None:
    """Draw the circles of CAMERA over the centre and the corners of an image."""
    output = given.output
    with report.stage("read"):
        from .. import check_camera
        from .. import show as run
        from ..display.overlay import find_places_to_check

        (flat,) = read_flats(given, given.image)
        camera = read_camera(given.camera, (flat.shape[1], flat.shape[0]))
        report.camera_warnings(given.camera, camera.warnings)
    with report.stage("show"):
        pixels = run(camera, flat)
        look = [place.sentence for place in find_places_to_check(camera, flat)]
        # What does not fit at all is drawn too: that is what to look for.
        warnings = check_camera(flat, camera).warnings
        camera = replace(camera, warnings=(*camera.warnings, *warnings))
    with report.stage("write"), atomic_write(output) as temporary:
        from PIL import Image

        Image.fromarray(pixels).save(temporary, compress_level=4)
    lines = (
        *(f"look: {words}" for words in look),
        f"{output}: the circles should lie on the microimages.",
    )
    report.finish(
        {"picture": str(output), **describe(camera), "look_at": look}, *summarise(camera), *lines
    )


@cl.command("lfcal flatten flat.png -c camera.json -o even.tif")
@click.argument("flat", type=cl.INPUT)
@cl.option("-c --camera", cl.INPUT, "Camera file with a gain map.", required=True)
@cl.option(*cl.DARK)
@cl.output_option("FLAT.tif", "Flattened flat to write.", suffixes=TIFF_SUFFIXES)
@cl.report_options(RESULTS["flatten"])
def flatten(report: cl.Report, given: Any) -> None:
    """Light the microimages of FLAT evenly, by the gain map of CAMERA.

    Pixels are divided by their gain; those of unknown gain stay.
    """
    output = given.output
    with report.stage("read"):
        from .. import check_camera

        (pixels,) = read_flats(given, given.flat)
        height, width = pixels.shape[:2]
        camera = read_camera(given.camera, (width, height))
        report.camera_warnings(given.camera, camera.warnings)
    with report.stage("flatten"), cl.name_file_in_errors(given.flat):
        even = camera.flatten(pixels)
        warnings = check_camera(pixels, camera).apply(camera, given.camera).warnings
    with report.stage("write"), atomic_write(output) as temporary:
        import tifffile

        tifffile.imwrite(temporary, even, photometric="rgb" if even.ndim == 3 else "minisblack")
    figures = {
        "written": str(output),
        "size": [width, height],
        "type": str(even.dtype),
        "warnings": warnings,
    }
    report.finish(
        figures, f"{output}: {width} x {height} px of {even.dtype}, evenly lit, in {report.took}."
    )
