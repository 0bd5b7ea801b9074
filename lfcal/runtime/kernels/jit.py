"""The decorator of kernels that Python calls: `numba.njit` with a cache, and loops shared out among threads."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import numba

from .sharing import share_out

__all__ = ["kernel"]


def kernel(
    function: Callable[..., Any] | None = None, /, *, share: Callable[..., int] | None = None, **options: Any
) -> Any:
    """Compile a function that Python calls, with the options of `numba.njit`, its cache, and without the interpreter.

    With `share`, a function of the arguments for the number of items, it is called without its first two arguments,
    the first item and the end of a part of them: see `.sharing`.

    Functions that only kernels call are decorated with `numba.njit`, without a cache: processes that compile kernels at
    the same time write no index of the cache together, and rounding does not depend on what comes from the cache.
    """
    if function is None:
        return lambda given: kernel(given, share=share, **options)
    compiled = numba.njit(cache=True, nogil=True, **options)(function)
    if share is None:
        return compiled
    count = share

    @wraps(function)
    def call(*arguments: Any) -> None:
        share_out(compiled, count(*arguments), arguments)

    shared: Any = call
    shared.kernel = compiled
    return shared
