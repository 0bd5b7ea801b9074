"""`lfrender warm`: compile kernels before they are needed, in an image of a container or on the nodes of a cluster."""

from __future__ import annotations

from typing import Any

from lfcal.runtime import console

from .inputs import CaptureInput
from .options import options

__all__ = ["warm"]


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
