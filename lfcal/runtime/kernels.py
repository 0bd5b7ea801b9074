"""Numba kernels: their decorator, loops shared among threads, floating-point options.

With `FAST`, sums may be reordered, but NaN keeps its meaning. Results must not depend on what a
process has compiled before:

- A kernel with `FAST` that other kernels call is inlined (`forceinline`): else it may be linked to
  another copy of itself with sums in another order, depending on whether it is just compiled or
  comes from the cache.
- Kernels with `FAST` use products instead of `x ** 2`, which Numba compiles only once, with the
  options of the first kernel that needs it (checked by a test).
- A kernel without options of its own takes those of its first caller; one with callers of both
  kinds states `fastmath=False` (checked by a test).
"""

from __future__ import annotations

import atexit
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, wraps
from itertools import count
from typing import Any

import numba

from .compilation.kernel_cache import record_checksums, remove_damaged

__all__ = ["FAST", "kernel", "share_out", "square"]

FAST = {"contract", "arcp", "nsz", "reassoc"}
# All kernels of this process.
_KERNELS: list[Any] = []


@numba.njit(inline="always")
def square(value):
    """The square of a value, for kernels with `FAST`."""
    return value * value


def kernel(
    function: Callable[..., Any] | None = None,
    /,
    *,
    share: Callable[..., int] | None = None,
    **options: Any,
) -> Any:
    """Compile a function that Python calls.

    It takes the options of `numba.njit`, is cached, and runs without the lock of the interpreter.

    With `share`, a function of the arguments for the number of items, it is called without its
    first two arguments, the first item and the end of a part of them: see `share_out`. Functions
    that only kernels call take `numba.njit`, without a cache: processes that compile at the same
    time write no index of the cache together.
    """
    if function is None:
        return lambda given: kernel(given, share=share, **options)
    compiled = numba.njit(cache=True, nogil=True, **options)(function)
    remove_damaged(compiled)
    _KERNELS.append(compiled)
    if share is None:
        return compiled

    @wraps(function)
    def call(*arguments: Any) -> None:
        share_out(compiled, share(*arguments), arguments)

    shared: Any = call
    shared.kernel = compiled
    return shared


@atexit.register
def _record_new() -> None:
    """Write the checksums of the kernels that this process has compiled."""
    for compiled in _KERNELS:
        if compiled.stats.cache_misses:
            record_checksums(compiled)


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(numba.config.NUMBA_NUM_THREADS, "kernels")  # type: ignore[attr-defined]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)


def share_out(kernel: Callable[..., Any], items: int, arguments: tuple[Any, ...]) -> None:
    """Call `kernel(begin, end, *arguments)` for parts of `range(items)` on several threads.

    The number of threads is that of Numba.

    Numba's own parallel loops take as long again to compile. No item may write where another reads
    or writes.
    """
    threads = min(numba.get_num_threads(), items)
    if threads <= 1:
        kernel(0, items, *arguments)
        return
    parts = 4 * threads  # so many that all threads end at about the same time
    numbers = count()

    def work() -> None:
        # The next number is taken by one thread alone.
        for part in numbers:
            if part >= parts:
                return
            begin = part * items // parts
            end = (part + 1) * items // parts
            if begin < end:
                kernel(begin, end, *arguments)

    others = [_pool().submit(work) for _ in range(threads - 1)]
    try:
        work()
    finally:
        for other in others:
            other.result()
