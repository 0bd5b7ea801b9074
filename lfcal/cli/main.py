"""Command line of lfcal: calibrate a camera; show, compare, convert camera files."""

from __future__ import annotations

import click
import cloup

from ..runtime import command_line as cl
from .assess import assess
from .calibrate import calibrate, lattice
from .cameras import compare, convert, info
from .flats import flatten, show
from .metric import board, metric

__all__ = ["main"]


@cloup.group(
    cls=cl.Program,
    name="lfcal",
    context_settings={"help_option_names": ["-h", "--help"]},
    others=(
        "lfrender",
        "analyze batch demo lenslet live refocus render report view views volume warm",
    ),
)
@click.version_option(package_name="lfrender", prog_name="lfcal")
def main() -> None:
    """Find the microimages of a focused plenoptic camera, and write them as a camera file."""


main.section("Calibrate a camera", calibrate, lattice)
main.section("Look at camera files", info, show, compare, assess)
main.section("Use them elsewhere", convert, flatten)
main.section("Measure in metres", board, metric)


if __name__ == "__main__":
    main()
