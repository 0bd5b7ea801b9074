"""`lfcal assess`: how the microlens array is mounted, and what to turn."""

from __future__ import annotations

from typing import Any

import click

from ..runtime import command_line as cl
from .inputs import RESULTS, read_flats

__all__ = ["assess"]


_MM = cl.Quantity(after="mm")
_UM = cl.Quantity(after="[uµ]m")


@cl.command(
    "lfcal assess white.png",
    "lfcal assess white.png scene.png --f-number 4 --pixel 5.5 -o page.html",
)
@click.argument("white", type=cl.INPUT)
@click.argument("scene", type=cl.INPUT, required=False)
@cl.option(
    "-c --camera", cl.INPUT, "Camera file made from WHITE, which is not calibrated again then."
)
@cl.option(
    "--f-number",
    cl.Quantity("f *[/=]"),
    "Of the main lens as the sensor sees it: for tilts in degrees.",
    "N",
)
@cl.option(
    "--pupil", _MM, "From the exit pupil of the main lens to the array [mm]; takes --pixel.", "MM"
)
@cl.option("--pixel", _UM, "Side of a pixel of the sensor [um].", "UM")
@cl.option(
    "--white-level",
    cl.Quantity(),
    "Largest value that pixels can have, 4095 of 12 bits; dim flats do not show it.",
    "N",
)
@cl.option(*cl.DARK)
@cl.output_option(
    "PAGE.html",
    "Page with a drawing of each figure.",
    required=False,
    suffixes=(".html", ".htm"),
)
@cl.report_options(RESULTS["assess"])
def assess(report: cl.Report, given: Any) -> int:
    """Tell from the white image WHITE how the microlens array is mounted, and what to turn.

    Rotation, tilt, distance and gaps of the microimages, each with its error and a verdict; light
    and dirt; from SCENE, a capture of the same camera, whether the array has moved, its exposure,
    and where each lens type is in focus. Of a WHITE that is no white image nothing but the rotation
    is measured (exit code 1).
    """
    output = given.output
    closing = []
    if given.pupil is not None and given.pixel is None:
        raise click.UsageError("--pupil needs --pixel")
    with report.stage("read"):
        from .. import assess as run
        from .. import load

        paths = [path for path in (given.white, given.scene) if path is not None]
        white, *scenes = read_flats(given, *paths)
        camera = given.camera and load(given.camera, (white.shape[1], white.shape[0]))
        if camera is not None:
            report.camera_warnings(given.camera, camera.warnings)
    with report.stage("assess"), cl.name_file_in_errors(given.white):
        found = run(
            white,
            *scenes,
            calibration=camera,
            f_number=given.f_number,
            pupil=given.pupil,
            pixel=given.pixel and given.pixel / 1000,
            white_level=given.white_level,
        )
    if output is not None:
        with report.stage("write"):
            found.write_page(output, f"Microlens array on {given.white.name}")
        closing = [f"{output} in {report.took}: open it in a browser."]
    figures = {"findings": found.to_dict(), "confidence": found.calibration.confidence}
    report.finish(
        {**figures, "warnings": found.calibration.warnings}, *str(found).splitlines(), *closing
    )
    if found.calibration.source == "white":
        return 0
    return 1
