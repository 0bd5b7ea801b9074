"""Imports that go on while a flat is being decoded, which leaves the interpreter idle."""

from __future__ import annotations

import gc
import sys
from contextlib import suppress
from importlib import import_module
from threading import Thread

__all__ = ["import_in_background"]


def import_in_background(*modules: str) -> None:
    """Begin to import these modules."""
    # What is imported stays: collecting garbage among it takes a tenth of the time.
    gc.disable()
    Thread(target=_import, args=modules).start()


def _import(*modules: str) -> None:
    # The compiler looks for the linear algebra of SciPy, which takes longer to import than the compiler itself. No
    # kernel of ours uses it, and this process runs no others.
    blas = "scipy.linalg.cython_blas"
    absent = blas not in sys.modules
    if absent:
        sys.modules[blas] = None  # type: ignore[assignment]
    try:
        import_module("numba.np.arraymath")
    finally:
        if absent:
            sys.modules.pop(blas, None)
        gc.freeze()
        gc.enable()
    # A command that fails at once ends while this goes on: nothing will be needed, and nobody minds.
    with suppress(RuntimeError):
        for module in modules:
            import_module(module)
