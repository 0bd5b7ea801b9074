"""Imports in a background thread, while reading a flat leaves the interpreter idle."""

from __future__ import annotations

import gc
from contextlib import suppress
from importlib import import_module
from threading import Thread

__all__ = ["import_in_background"]


def import_in_background(*modules: str) -> None:
    """Start to import these modules in another thread."""
    # Imported objects stay: looking for garbage among them would take a tenth of the time.
    gc.disable()
    Thread(target=_import, args=modules).start()


def _import(*modules: str) -> None:
    try:
        import_module("numba")
    finally:
        gc.freeze()
        gc.enable()
    # A command that fails at once may end meanwhile; the modules are not needed then.
    with suppress(RuntimeError):
        for module in modules:
            import_module(module)
