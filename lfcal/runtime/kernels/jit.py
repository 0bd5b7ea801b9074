"""The decorator of kernels: as `numba.njit`, but a kernel is prepared only when it is first needed."""

from __future__ import annotations

from collections.abc import Callable
from threading import RLock
from typing import Any

from .sharing import share_out

__all__ = ["Kernel", "njit"]

_lock = RLock()
# Names in kernels that make arrays, or errors with values.
_ALLOCATING = {
    "ValueError", "arange", "argsort", "array", "copy", "empty", "empty_like", "full", "ones", "sort", "zeros",
    "zeros_like",
}  # fmt: skip


class Kernel:
    """A function that Numba compiles; called from Python, or from other kernels."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        self._share: Callable[..., int] | None = options.pop("share", None)
        self.py_func = function
        # Counting references to arrays takes a third of the time of some kernels; one that makes none can do without.
        self.options = {"_nrt": not _ALLOCATING.isdisjoint(function.__code__.co_names), **options}
        self.__name__, self.__qualname__ = function.__name__, function.__qualname__
        self.__module__, self.__doc__ = function.__module__, function.__doc__

    def __call__(self, *arguments: Any) -> Any:
        if self._share is None:
            return self.dispatcher(*arguments)
        share_out(self.dispatcher, self._share(*arguments), arguments)
        return None

    def __getattr__(self, name: str) -> Any:
        # Reached only for what is not set yet: the dispatchers, and all that the first has.
        if name in ("dispatcher", "linked"):
            return self._prepare(name)
        if name == "_numba_type_":
            from numba import types

            return types.Dispatcher(self.linked)
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.dispatcher, name)

    def __repr__(self) -> str:
        return f"<kernel {self.__module__}.{self.__qualname__}>"

    def _prepare(self, name: str) -> Any:
        """Make the `dispatcher` that Python calls, or the one that is `linked` with other kernels: it makes no machine
        code and no wrapper for Python."""
        with _lock:
            made = self.__dict__.get(name)
            if made is None:
                import numba

                from .cache import enable_cache
                from .compilation import watch_compilation
                from .library import generate_on_demand

                watch_compilation()
                generate_on_demand()
                # Nobody calls kernels from C.
                options = {**self.options, "cache": False, "no_cfunc_wrapper": True}
                compiler: Any = numba.njit
                made = compiler(**options)(self.py_func)
                made.only_linked = name == "linked"
                if self.options.get("cache"):
                    enable_cache(self, made)
                setattr(self, name, made)
        return made


def njit(function: Callable[..., Any] | None = None, /, **options: Any) -> Any:
    """Make a `Kernel` of a function, with the options of `numba.njit`; `cache=True` is the cache of `.cache`.

    With `share`, a function of the arguments for the number of items, the kernel is called from Python without its
    first two arguments, the first item and the end of a part of them: see `.sharing`. Kernels call it with them.
    """
    if function is not None:
        return Kernel(function, options)
    return lambda function: Kernel(function, options)
