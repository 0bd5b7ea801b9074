"""Command line of lfcal: calibrate a camera from one image, look at a camera file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .console import Program, Report, report_options
from .outfile import check_output

if TYPE_CHECKING:
    from .calibration import Calibration

__all__ = ["main"]

_PATH = click.Path(path_type=Path)


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
def calibrate(image: Path, output: Path, kind: str, as_json: bool, quiet: bool) -> None:
    """Find the microlens lattice on IMAGE, a white image or any scene capture, and write it as a camera file."""
    report = Report(as_json, quiet)
    check_output(output, {".json"})
    with report.stage("read"):
        from . import calibrate as run
        from . import read_flat

        flat = read_flat(image)
    report.announce_compilation("lfcal")
    with report.stage("calibrate"):
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
    import numpy as np

    lattice = camera.lattice
    a1, a2 = lattice.basis
    shape = "hexagonal" if len(lattice.steps) == 6 else "square" if _is_square(a1, a2) else "rectangular or oblique"
    return {
        "size": list(camera.image_size),
        "lattice": shape,
        "pitch": lattice.pitch,
        "rotation_degrees": float(np.degrees(np.arctan2(a1[1], a1[0]))),
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


def _is_square(a1: Any, a2: Any) -> bool:
    """Whether two basis vectors are equally long and perpendicular to within five per cent."""
    long, short = max(a1 @ a1, a2 @ a2), min(a1 @ a1, a2 @ a2)
    return bool(abs(a1 @ a2) < 0.05 * long and short > 0.9 * long)
