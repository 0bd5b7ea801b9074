"""Share the items of a loop out among threads, for kernels that release the interpreter.

Numba's own parallel loops take as long again to compile. A kernel that is shared out works on the items from its first
argument to its second; no item may write where another reads or writes.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from threading import Lock
from typing import Any

import numba

__all__ = ["share_out"]

# Parts for each thread: enough that all threads end at about the same time.
_PARTS = 4
_lock = Lock()
_pools: dict[int, ThreadPoolExecutor] = {}
os.register_at_fork(after_in_child=_pools.clear) if hasattr(os, "register_at_fork") else None


def _pool(threads: int) -> ThreadPoolExecutor:
    with _lock:
        if threads not in _pools:
            _pools[threads] = ThreadPoolExecutor(threads, "kernels")
        return _pools[threads]


def share_out(kernel: Callable[..., Any], items: int, arguments: tuple[Any, ...]) -> None:
    """Call `kernel(begin, end, *arguments)` for parts of `range(items)`, on as many threads as Numba may use."""
    threads = min(numba.get_num_threads(), items)
    if threads <= 1:
        kernel(0, items, *arguments)
        return
    parts = _PARTS * threads
    numbers = count()

    def work() -> None:
        # The next number is taken by one thread alone.
        for part in numbers:
            if part >= parts:
                return
            begin, end = part * items // parts, (part + 1) * items // parts
            if begin < end:
                kernel(begin, end, *arguments)

    others = [_pool(threads - 1).submit(work) for _ in range(threads - 1)]
    try:
        work()
    finally:
        for other in others:
            other.result()
