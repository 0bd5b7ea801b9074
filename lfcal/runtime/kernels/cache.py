"""Numba's cache on disk, with three differences: an entry is valid as long as kernel and named tuples are the same,
a kernel is compiled by one process while others wait for it, and a damaged entry is compiled anew."""

from __future__ import annotations

import os
import pickle
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Any
from weakref import WeakSet

from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.runtime import rtsys

from .compilation import announce_miss
from .digest import digest_kernel

try:
    import fcntl
except ImportError:  # Windows: processes compile side by side
    fcntl = None  # type: ignore[assignment]

if TYPE_CHECKING:
    from .jit import Kernel

__all__ = ["enable_cache", "release_locks"]

_DAMAGED = (EOFError, pickle.UnpicklingError, ValueError, KeyError, AttributeError, ImportError, IndexError)
_caches: WeakSet[_KernelCache] = WeakSet()


def enable_cache(kernel: Kernel, dispatcher: Any) -> None:
    """Give a dispatcher the cache of its kernel; none where no folder can be written to."""
    with suppress(RuntimeError):
        dispatcher._cache = _KernelCache(kernel, dispatcher.only_linked)


def release_locks() -> None:
    """Let other processes compile the kernels that this one has begun, after an error."""
    for cache in list(_caches):
        for sig in list(cache._locks):
            cache.unlock(sig)


def _fields(types: Any) -> tuple[Any, ...]:
    """Names of the fields of named tuples among types."""
    return tuple((t.fields, _fields(t.types)) for t in types if hasattr(t, "fields") and hasattr(t, "types"))


class _KernelCache(FunctionCache):
    def __init__(self, kernel: Kernel, linked: bool) -> None:
        super().__init__(kernel.py_func)
        self._kernel = kernel
        module = kernel.__module__.rpartition(".")[2]
        name = f"{module}.{kernel.__qualname__}".replace("<", "").replace(">", "") + (".linked" if linked else "")
        version = f"py{sys.version_info[0]}{sys.version_info[1]}{getattr(sys, 'abiflags', '')}"
        # Without the number of the line, so that a kernel that has only moved is found again.
        self._cache_file = IndexDataCacheFile(self._cache_path, f"{name}.{version}", digest_kernel(kernel))
        self._lock_path = os.path.join(self._cache_path, f"{name}.{version}.lock")
        self._locks: dict[Any, int] = {}
        _caches.add(self)

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        # For Numba named tuples are the same if their names are; places of fields are compiled in.
        return (*super()._index_key(sig, codegen), _fields(sig))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = self._load(sig, target_context)
        if found is None and announce_miss(self._kernel, sig):
            found = self._load(sig, target_context)
        if found is None and self._lock(sig):
            # Another process may have compiled it meanwhile.
            found = self._load(sig, target_context)
            if found is not None:
                self.unlock(sig)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            # A full disk or one that has become read-only only means to compile again.
            with suppress(OSError):
                super().save_overload(sig, data)
        finally:
            self.unlock(sig)

    def holds(self, sig: Any, codegen: Any) -> bool:
        """Whether there is an entry for these types."""
        try:
            return self._index_key(sig, codegen) in self._cache_file._load_index()
        except (OSError, *_DAMAGED):
            return False

    def _load(self, sig: Any, target_context: Any) -> Any:
        # Not as Numba does: what is needed to type and compile kernels takes longer to load than many kernels.
        rtsys.initialize(target_context)
        try:
            with self._guard_against_spurious_io_errors():
                return self._load_overload(sig, target_context)
        except OSError:
            return None
        except _DAMAGED:
            with suppress(OSError):
                self._cache_file.flush()
            return None

    def _lock(self, sig: Any) -> bool:
        """Wait until no other process compiles the kernel; whether there is a lock now."""
        # A lock of this process, for other types, would never come free while it waits.
        if fcntl is None or self._locks:
            return False
        try:
            lock = os.open(self._lock_path, os.O_CREAT | os.O_RDWR)
        except OSError:
            return False
        try:
            fcntl.flock(lock, fcntl.LOCK_EX)
        except OSError:
            os.close(lock)
            return False
        self._locks[sig] = lock
        return True

    def unlock(self, sig: Any) -> None:
        """Let other processes compile the kernel."""
        lock = self._locks.pop(sig, None)
        if lock is not None:
            # A process that waits for the file removed here finds the kernel in the cache.
            with suppress(OSError):
                os.unlink(self._lock_path)
            os.close(lock)
