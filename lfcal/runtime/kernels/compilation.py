"""What happens while Numba compiles: garbage collection rests, and whoever wants to know of it is told."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from time import thread_time
from typing import Any

from numba.core import event

from .jit import Kernel

__all__ = ["announce_miss", "observe_compilation", "observe_misses", "watch_compilation"]

#: Gets a kernel that Python calls and its signature, before it is compiled; returns whether the cache may have it now.
MissObserver = Callable[[Kernel, Any], bool]
#: Gets the dispatcher, the signature and the processor seconds of each compiled kernel that Python calls.
Observer = Callable[[Any, Any, float], None]
_miss_observers: list[MissObserver] = []
_observers: list[Observer] = []


class _Listener(event.Listener):
    """Numba lets one thread compile at a time, so that one counter of nested calls is enough."""

    depth = 0

    def on_start(self, event: Any) -> None:
        self.depth += 1
        if self.depth == 1:
            # Compiling makes millions of objects that live to its end: looking for garbage takes a fifth of the time.
            self.collecting = gc.isenabled()
            gc.disable()
            self.start = thread_time()

    def on_end(self, event: Any) -> None:
        self.depth -= 1
        data = event.data
        if event.is_failed:
            unlock = getattr(data["dispatcher"]._cache, "unlock", None)
            if unlock:
                unlock(data["args"])
        if self.depth == 0:
            if self.collecting:
                gc.enable()
            for observer in list(_observers):
                observer(data["dispatcher"], data["args"], thread_time() - self.start)


_listener = _Listener()


@cache
def watch_compilation() -> None:
    """Listen to Numba from now on; once per process."""
    event.register("numba:compile", _listener)


@contextmanager
def observe_compilation(observer: Observer) -> Iterator[None]:
    """Call a function after each kernel that is compiled in this process."""
    watch_compilation()
    with _observing(_observers, observer):
        yield


@contextmanager
def observe_misses(observer: MissObserver) -> Iterator[None]:
    """Call a function before a kernel is compiled in this process."""
    watch_compilation()
    with _observing(_miss_observers, observer):
        yield


@contextmanager
def _observing(observers: list[Any], observer: Any) -> Iterator[None]:
    observers.append(observer)
    try:
        yield
    finally:
        observers.remove(observer)


def announce_miss(kernel: Kernel, signature: Any) -> bool:
    """Call the observers of misses; whether one of them may have put the kernel into the cache."""
    if _listener.depth or not _miss_observers:
        return False
    answers = [observer(kernel, signature) for observer in list(_miss_observers)]
    return any(answers)
