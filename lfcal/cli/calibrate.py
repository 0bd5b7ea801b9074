"""Commands that make a camera file: from images, or from stated figures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cloup

from ..runtime import command_line as cl
from ..runtime.image_formats import MOSAICS
from .figures import describe, summarise
from .inputs import RESULTS, read_flats

if TYPE_CHECKING:
    from ..camera.calibration import Calibration

__all__ = ["calibrate", "lattice"]

_CAMERA = cl.output_option("CAMERA.json", "Camera file to write.", ".json", suffixes=(".json",))
_FILES = (_CAMERA, cl.option(*cl.DARK))
_KNOWN = (
    cl.option(
        "--kind",
        click.Choice(["auto", "white", "scene"]),
        "What the images show: an evenly lit white surface, or any scene.",
        default="auto",
        show_default=True,
    ),
    cl.option(
        "--mosaic",
        click.Choice(MOSAICS, case_sensitive=False),
        "Colour filters of the top left 2 x 2 pixels of a raw mosaic, row by row. By default it "
        "is detected.",
    ),
    cl.option(
        "--pitch", click.FloatRange(0, min_open=True), "Pitch, right to a tenth, as hint.", "PX"
    ),
    cl.option(
        "--rotation", float, "Beside --pitch: as 'lfcal info' prints it, to 2 degrees.", "DEGREES"
    ),
    cl.option(
        "--linear/--encoded",
        None,
        "Whether values are in proportion to light, or encoded for display. By default 8 bits and "
        "videos are taken as encoded.",
        default=None,
    ),
)
_LATTICE = (
    cl.option("--size", cl.SIZE, "Size of the flats [px].", required=True),
    cl.option("--pitch", float, "Distance between neighbouring centres [px].", "PX", required=True),
    cl.option(
        "--arrangement",
        click.Choice(["hexagonal", "hexagonal-vertical", "square"]),
        "Of the microlenses; hexagonal ones in rows across, or down (vertical).",
        default="hexagonal",
        show_default=True,
    ),
    cl.option(
        "--rotation", float, "Clockwise on the screen [degrees].", default=0.0, show_default=True
    ),
    cl.option(
        "--centre", (float, float), "Of any microimage [px].  [default: middle of the flat]", "X Y"
    ),
    cl.option(
        "--radius", float, "Usable radius of the microimages [px].  [default: half the pitch]", "PX"
    ),
)


def _write(report: cl.Report, camera: Calibration, output: Path, *lines: str) -> None:
    camera.save(output)
    report.finish({"camera": str(output), **describe(camera)}, *lines)


@cl.command(
    "lfcal calibrate white.png -o camera.json",
    "lfcal calibrate white1.png white2.png -o camera.json",
    "lfcal calibrate scene.tif --kind scene --mosaic rggb -o camera.json",
    "lfcal calibrate scene.tif --pitch 15.4 --dark dark.tif -o camera.json",
)
@cl.several_inputs("images", "IMAGE...")
@cloup.option_group("Files", *_FILES)
@cloup.option_group("What is known", *_KNOWN)
@cloup.option_group("Reading IMAGE", *(cl.option(*row) for row in cl.READING.values()))
@cl.report_options(RESULTS["camera"])
def calibrate(report: cl.Report, given: Any) -> None:
    """Find the microlenses on IMAGE and write them as a camera file.

    IMAGE is a white image, or any capture of a scene. Several white images, or several captures of
    one camera, are combined.
    """
    images = given.images
    output = given.output
    if given.rotation is not None and given.pitch is None:
        raise click.UsageError("--rotation needs --pitch")
    with report.stage("read"):
        from .. import calibrate as run

        reading = {name: getattr(given, name) for name in cl.READING}
        flats = read_flats(given, *images, **reading)
    named = str(images[0])
    if len(images) > 1:
        named += " ..."
    with report.stage("calibrate"), cl.name_file_in_errors(named):
        camera = run(
            flats if len(flats) > 1 else flats[0],
            given.kind,
            given.mosaic,
            given.pitch,
            given.rotation,
        )
        if given.linear is not None:
            camera = replace(camera, encoded=not given.linear)
    _write(report, camera, output, *summarise(camera), f"{output} in {report.took}.")


@cl.command(
    "lfcal lattice --size 2048x1536 --pitch 15.41 --arrangement square -o camera.json",
    "lfcal lattice --size 2048x2048 --pitch 23.2 --centre 1019.8 1031.2 -o camera.json",
)
@cl.with_options(*_LATTICE, _CAMERA)
@cl.report_options(RESULTS["camera"])
def lattice(report: cl.Report, given: Any) -> None:
    """State the lattice of a camera that no flat shows well enough.

    The light of the microimages stays unknown. Commands that use the file check it against the
    flat.
    """
    from ..camera.calibration import Calibration
    from ..lattice.stated import state_lattice

    try:
        stated = state_lattice(
            given.size, given.pitch, given.arrangement, given.rotation, given.centre, given.radius
        )
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    warning = "the lattice was stated, not measured"
    camera = Calibration(stated, source="published", confidence=1.0, warnings=(warning,))
    _write(
        report,
        camera,
        given.output,
        summarise(camera)[0],
        f"{given.output} is written; check it with 'lfcal show'.",
    )
