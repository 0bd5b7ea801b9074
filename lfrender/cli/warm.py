"""`lfrender warm`: compile kernels before they are needed, in an image of a container or on the nodes of a cluster."""

from __future__ import annotations

import click

from lfcal.runtime import console

__all__ = ["warm"]


@console.command("lfrender warm", "lfrender warm --processes 4")
@click.option("--processes", type=click.IntRange(1), metavar="N", help="Processes that compile. [default: all cores]")
@console.report_options
def warm(processes: int | None, as_json: bool, quiet: bool) -> None:
    """Compile all kernels ahead, so that no command has to.

    The kernels of lfcal and lfrender, for flats of all kinds, go into Numba's cache. Commands compile what they
    need when they first need it; after this they find it.
    """
    from lfcal.runtime.kernels.signatures import read_signatures

    report = console.Report(as_json, quiet)
    with report.stage("compile"):
        compiled, failed = report.compile_ahead(read_signatures(), processes)
    more = f"; {failed} could not be compiled" if failed else ""
    report.finish(
        {"kernels_compiled": compiled, "kernels_failed": failed},
        f"{compiled or 'No'} kernels had to be compiled, in {report.took}{more}.",
    )
