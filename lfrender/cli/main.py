"""Command line of lfrender: analyse depth, render pictures, show what the toolkit does."""

from __future__ import annotations

from typing import Any

import click
import cloup

from lfcal.runtime import console

from .analyze import analyze
from .inputs import CaptureInput
from .options import options
from .pages import demo, report, view
from .render import render
from .sequence import batch
from .views import refocus, views

__all__ = ["main"]


@console.command("lfrender warm", "lfrender warm --processes 4")
@options(own={"What to compile": "processes"}, refused="no flat is read")
def warm(capture: CaptureInput, given: Any) -> None:
    """Compile all kernels, unless that has been done for this installation.

    The first command does so too. The kernels of lfcal and lfrender, for flats of all kinds, go into Numba's cache.
    """
    report = capture.report
    failed = report.compile_kernels(given.processes)
    seconds = report.compile_seconds
    more = f"; {failed} could not be compiled" if failed else ""
    done = "All kernels were compiled already." if failed is None else f"Kernels compiled in {seconds:.0f} s{more}."
    report.finish({"compiled": failed is not None, "kernels_failed": failed or 0, "compile_seconds": seconds}, done)


# Commands that are often typed here by mistake, and the program that has them.
_OTHER_PROGRAMS = dict.fromkeys(
    ("board", "calibrate", "compare", "convert", "flatten", "info", "lattice", "metric", "show"), "lfcal"
)


@cloup.group(
    cls=console.CommandGroup,
    name="lfrender",
    context_settings={"help_option_names": ["-h", "--help"]},
    other_programs=_OTHER_PROGRAMS,
    file_command="render {} -o picture.tif",
)
@click.version_option(package_name="lfrender", prog_name="lfrender")
def main() -> None:
    """Depth and full-resolution pictures from focused plenoptic captures."""


main.section("First steps", demo, warm)
main.section("One capture", render, analyze, refocus, views)
main.section("Look and share", view, report)
main.section("Sequences", batch)


if __name__ == "__main__":
    main()
