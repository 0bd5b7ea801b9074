"""Command line of lfcal: calibrate a camera from one image, look at a camera file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from .console import Program, Report, about, report_options
from .outfile import check_output

if TYPE_CHECKING:
    from .calibration import Calibration
    from .lattice import Lattice

__all__ = ["main"]

_PATH = click.Path(path_type=Path)
# Sides that differ by less than this share, and angles this near to 90 degrees (as a cosine), count as square.
_SQUARE_TOLERANCE = 0.03


@click.group(cls=Program, name="lfcal", context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="lfrender", prog_name="lfcal")
def main() -> None:
    """Find the microimages of a focused plenoptic camera."""


@main.command()
@click.argument("image", type=_PATH)
@click.option("-o", "--output", type=_PATH, required=True, metavar="CAMERA.json", help="Camera file to write.")
@click.option(
    "--kind",
    type=click.Choice(["auto", "white", "scene"]),
    default="auto",
    show_default=True,
    help="What IMAGE shows: an evenly lit white surface, or any scene.",
)
@report_options
def calibrate(image: Path, output: Path, kind: Literal["auto", "white", "scene"], as_json: bool, quiet: bool) -> None:
    """Find the microlens lattice on IMAGE, a white image or any scene capture, and write it as a camera file."""
    report = Report(as_json, quiet)
    check_output(output, {".json"}, [image])
    with report.stage("read"):
        from . import calibrate as run
        from . import read_flat

        flat = read_flat(image)
    report.announce_compilation("lfcal")
    with report.stage("calibrate"), about(image):
        camera = run(flat, kind=kind)
    camera.save(output)
    report.finish({"camera": str(output), **describe(camera)})


@main.command()
@click.argument("camera", type=_PATH)
@report_options
def info(camera: Path, as_json: bool, quiet: bool) -> None:
    """Show what is in the camera file CAMERA."""
    from . import load

    Report(as_json, quiet).finish({"camera": str(camera), **describe(load(camera))})


def describe(camera: Calibration) -> dict[str, Any]:
    """The figures of a calibration a person asks for, in words and pixels."""
    lattice = camera.lattice
    shape, rows, rotation = _orientation(lattice)
    return {
        "size": list(camera.image_size),
        "lattice": shape,
        "rows": rows,
        "rotation_degrees": rotation,
        "pitch": lattice.pitch,
        "radius": lattice.radius,
        "origin": lattice.origin,
        "basis": lattice.basis,
        "lenses": len(lattice),
        "source": camera.source,
        "lenses_used": camera.lenses_used,
        "residual_rms": camera.residual_rms,
        "confidence": camera.confidence,
        "warnings": list(camera.warnings),
    }


def _orientation(lattice: Lattice) -> tuple[str, str, float]:
    """Shape, which way the rows of nearest neighbours run, and how far they are turned from there [degrees]."""
    import numpy as np

    a1, a2 = lattice.basis
    lengths = np.hypot(*a1), np.hypot(*a2)
    hexagonal = len(lattice.steps) == 6
    if hexagonal:
        shape = "hexagonal"
    elif abs(a1 @ a2) > _SQUARE_TOLERANCE * lengths[0] * lengths[1]:
        shape = "oblique"
    else:
        shape = "square" if min(lengths) > (1 - _SQUARE_TOLERANCE) * max(lengths) else "rectangular"
    period = 60.0 if hexagonal else 90.0
    turned = (float(np.degrees(np.arctan2(a1[1], a1[0]))) + period / 2) % period - period / 2
    if hexagonal and abs(turned) > 15:
        return shape, "vertical", turned - np.copysign(30.0, turned)
    return shape, "horizontal" if hexagonal else "both ways", turned


if __name__ == "__main__":
    main()
