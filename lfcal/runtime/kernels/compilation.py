"""What happens while Numba compiles: garbage collection rests, and whoever wants to know of it is told."""

from __future__ import annotations

import gc
from functools import cache
from time import thread_time
from typing import Any

from numba.core import event

from . import observers

__all__ = ["announce_miss", "compiled_dispatcher", "watch_compilation"]


class _Listener(event.Listener):
    """Numba lets one thread compile at a time, so that one list of nested calls is enough."""

    def __init__(self) -> None:
        self.nested: list[Any] = []

    def on_start(self, event: Any) -> None:
        self.nested.append(event.data["dispatcher"])
        if len(self.nested) == 1:
            # Compiling makes millions of objects that live to its end: looking for garbage takes a fifth of the time.
            self.collecting = gc.isenabled()
            gc.disable()
            self.start = thread_time()

    def on_end(self, event: Any) -> None:
        self.nested.pop()
        data = event.data
        if event.is_failed:
            unlock = getattr(data["dispatcher"]._cache, "unlock", None)
            if unlock:
                unlock(data["args"])
        if not self.nested:
            if self.collecting:
                gc.enable()
            observers.compiled(data["dispatcher"], data["args"], thread_time() - self.start)


_listener = _Listener()


@cache
def watch_compilation() -> None:
    """Listen to Numba from now on; once per process."""
    event.register("numba:compile", _listener)


def announce_miss(kernel: Any, types: Any) -> bool:
    """Call the observers of misses, unless it is within another kernel; whether the cache may have the kernel now."""
    return not _listener.nested and observers.missed(kernel, types)


def compiled_dispatcher() -> Any:
    """The innermost dispatcher that compiles now, or None."""
    return _listener.nested[-1] if _listener.nested else None
