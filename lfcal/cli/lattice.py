"""`lfcal lattice`: a camera file whose lattice is stated by its figures."""

from __future__ import annotations

from pathlib import Path

import click

from ..runtime import console
from ..runtime.output_file import check_output

__all__ = ["lattice"]


@console.command(
    "lfcal lattice --size 2048x1536 --pitch 15.41 --arrangement square -o camera.json",
    "lfcal lattice --size 2048x2048 --pitch 23.2 --centre 1019.8 1031.2 -o camera.json",
)
@click.option("--size", type=console.SizeOption(), required=True, metavar="WxH", help="Size of the flats [px].")
@click.option("--pitch", type=float, required=True, metavar="PX", help="Distance between neighbouring centres [px].")
@click.option(
    "--arrangement",
    type=click.Choice(["hexagonal", "hexagonal-vertical", "square"]),
    default="hexagonal",
    show_default=True,
    help="Of the microlenses; hexagonal ones in rows across, or down (vertical).",
)
@click.option("--rotation", type=float, default=0.0, show_default=True, help="Clockwise on the screen [degrees].")
@click.option(
    "--centre", type=float, nargs=2, metavar="X Y", help="Of any microimage [px].  [default: middle of the flat]"
)
@click.option(
    "--radius", type=float, metavar="PX", help="Usable radius of the microimages [px].  [default: half the pitch]"
)
@click.option(
    "-o",
    "--output",
    type=console.OutputPath(".json"),
    required=True,
    metavar="CAMERA.json",
    help="Camera file to write.",
)
@console.report_options
def lattice(
    size: tuple[int, int],
    pitch: float,
    arrangement: str,
    rotation: float,
    centre: tuple[float, float] | None,
    radius: float | None,
    output: Path,
    as_json: bool,
    quiet: bool,
) -> None:
    """State the lattice of a camera that no flat shows well enough.

    The light of the microimages stays unknown. Commands that use the file check it against the flat.
    """
    check_output(output, {".json"})
    from ..camera.calibration import Calibration
    from ..lattice.stated import state_lattice
    from .figures import describe, summarise

    try:
        stated = state_lattice(size, pitch, arrangement, rotation, centre, radius)
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    warning = "the lattice was stated, not measured"
    camera = Calibration(stated, source="published", confidence=1.0, warnings=(warning,))
    camera.save(output)
    figures = {"camera": str(output), **describe(camera)}
    console.Report(as_json, quiet).finish(
        figures, summarise(camera)[0], f"{output} is written; check it with 'lfcal show'."
    )
