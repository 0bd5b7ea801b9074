"""The decorator of kernels: `numba.njit`, and loops that are shared out among threads."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

import numba

from .sharing import share_out

__all__ = ["njit"]


def njit(
    function: Callable[..., Any] | None = None, /, *, share: Callable[..., int] | None = None, **options: Any
) -> Any:
    """Compile a function with the options of `numba.njit`.

    With `share`, a function of the arguments for the number of items, the kernel is called without its first two
    arguments, the first item and the end of a part of them: see `.sharing`.
    """
    if function is None:
        return lambda given: njit(given, share=share, **options)
    kernel = numba.njit(**options)(function)
    if share is None:
        return kernel
    count = share

    @wraps(function)
    def call(*arguments: Any) -> None:
        share_out(kernel, count(*arguments), arguments)

    shared: Any = call
    shared.kernel = kernel
    return shared
