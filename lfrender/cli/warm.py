"""`lfrender warm`: compile kernels before they are needed, in an image of a container or on the nodes of a cluster."""

from __future__ import annotations

import click

from lfcal.runtime import console

__all__ = ["warm"]


@console.command("lfrender warm", "lfrender warm --processes 4")
@click.option("--processes", type=click.IntRange(1), metavar="N", help="Processes that compile. [default: all cores]")
@console.report_options
def warm(processes: int | None, as_json: bool, quiet: bool) -> None:
    """Compile all kernels, unless that has been done for this installation.

    The first command does so too. The kernels of lfcal and lfrender, for flats of all kinds, go into Numba's cache.
    """
    report = console.Report(as_json, quiet)
    failed = report.compile_kernels(processes)
    seconds = report.compile_seconds
    more = f"; {failed} could not be compiled" if failed else ""
    done = "All kernels were compiled already." if failed is None else f"Kernels compiled in {seconds:.0f} s{more}."
    report.finish({"compiled": failed is not None, "kernels_failed": failed or 0, "compile_seconds": seconds}, done)
