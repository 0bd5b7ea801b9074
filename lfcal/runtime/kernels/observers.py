"""Functions that are called before and after kernels are compiled in this process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["compiled", "missed", "observe_compilation", "observe_misses"]

# Gets a kernel that Python calls and its types, before it is compiled; returns whether the cache may have it now.
_MissObserver = Callable[[Any, Any], bool]
# Gets the dispatcher of a kernel that Python calls, its types, and the processor seconds that compiling it has taken.
_Observer = Callable[[Any, Any, float], None]
_miss_observers: list[_MissObserver] = []
_observers: list[_Observer] = []


@contextmanager
def observe_misses(observer: _MissObserver) -> Iterator[None]:
    """Call a function before a kernel that the cache does not have is compiled in this process."""
    _miss_observers.append(observer)
    try:
        yield
    finally:
        _miss_observers.remove(observer)


@contextmanager
def observe_compilation(observer: _Observer) -> Iterator[None]:
    """Call a function after each kernel that is compiled in this process."""
    _observers.append(observer)
    try:
        yield
    finally:
        _observers.remove(observer)


def missed(kernel: Any, types: Any) -> bool:
    """Call the observers of misses; whether one of them may have put the kernel into the cache."""
    return any([observer(kernel, types) for observer in list(_miss_observers)])  # noqa: C419 - all are called


def compiled(dispatcher: Any, types: Any, seconds: float) -> None:
    """Call the observers of compilation."""
    for observer in list(_observers):
        observer(dispatcher, types, seconds)
