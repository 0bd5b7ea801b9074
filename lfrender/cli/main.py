"""Command line of lfrender: analyse depth, render pictures, show what the toolkit does."""

from __future__ import annotations

import click
import cloup

from lfcal.runtime import console

from .analyze import analyze
from .pages import demo, report, view
from .render import render
from .sequence import batch
from .views import refocus, views
from .warm import warm

__all__ = ["main"]


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
