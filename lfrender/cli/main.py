"""Command line of lfrender: analyse depth, render pictures, show what the toolkit does."""

from __future__ import annotations

from typing import Any

import click
import cloup

from lfcal.runtime import command_line as cl

from .analyze import analyze
from .live import live
from .options import RESULTS, declare
from .pages import demo, report, view
from .render import render
from .sequence import batch
from .views import lenslet, refocus, views
from .volume import volume

__all__ = ["main"]


@cl.command("lfrender warm", "lfrender warm --processes 4")
@declare("processes")
@cl.report_options(RESULTS["warm"])
def warm(report: cl.Report, given: Any) -> None:
    """Compile all kernels ahead, once for each installation.

    The first command does so too. The kernels of lfcal and lfrender, for flats of all kinds, go
    into Numba's cache.
    """
    failed = report.compile_kernels(given.processes)
    seconds = report.compile_seconds
    done = f"Kernels compiled in {seconds:.0f} s"
    if failed is None:
        done = "All kernels were compiled already"
    elif failed:
        done += f"; {failed} could not be compiled"
    report.finish(
        {"compiled": failed is not None, "kernels_failed": failed or 0, "compile_seconds": seconds},
        f"{done}.",
    )


@cloup.group(
    cls=cl.Program,
    name="lfrender",
    context_settings={"help_option_names": ["-h", "--help"]},
    others=(
        "lfcal",
        "assess board calibrate compare convert flatten info lattice metric show",
    ),
)
@click.version_option(package_name="lfrender", prog_name="lfrender")
def main() -> None:
    """Depth and full-resolution pictures from focused plenoptic captures."""


main.section("First steps", demo, warm)
main.section("One capture", render, analyze, refocus, views, volume)
main.section("Look and share", view, report)
main.section("Sequences", batch, live)
main.section("Other programs", lenslet)


if __name__ == "__main__":
    main()
