"""Command line of lfrender: analyse depth, render pictures, show what the toolkit does."""

from __future__ import annotations

import click

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


@click.group(
    cls=console.CommandGroup,
    name="lfrender",
    context_settings={"help_option_names": ["-h", "--help"]},
    other_programs=_OTHER_PROGRAMS,
    file_command="render {} -o picture.tif",
)
@click.version_option(package_name="lfrender", prog_name="lfrender")
def main() -> None:
    """Depth and full-resolution pictures from focused plenoptic captures."""


for _command in (analyze, render, refocus, views, batch, view, report, demo, warm):
    main.add_command(_command)


if __name__ == "__main__":
    main()
