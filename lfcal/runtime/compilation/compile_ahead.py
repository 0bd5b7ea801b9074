"""Compile kernels ahead, in one process per core, which leave them in Numba's cache.

`signatures.json` lists kernels with the types of their arguments, the dearest first (written by
`python -m benchmarks.kernels --record`). A kernel that is missing there is compiled when it is
first called.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, suppress
from importlib import import_module
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from ..file_lock import file_lock
from .kernel_cache import record_checksums

__all__ = [
    "SIGNATURE_FILE",
    "compile_ahead",
    "compile_once",
    "decode_type",
    "is_compiled",
]

SIGNATURE_FILE = Path(__file__).with_name("signatures.json")
_Progress = Callable[[int, int], None]


def is_compiled() -> bool:
    """Whether `compile_once` has been run for this installation."""
    with suppress(OSError):
        return _record().read_text(encoding="utf-8") == _installation()
    return False


def compile_once(processes: int | None = None, progress: _Progress | None = None) -> int:
    """As `compile_ahead`, unless it is done, or another process does it now: that is waited for."""
    with ExitStack() as stack:
        # A folder that cannot be written to holds no kernels either.
        with suppress(OSError):
            stack.enter_context(file_lock(_record().with_suffix(".lock"), wait=True))
        if is_compiled():
            return 0
        failed = compile_ahead(processes, progress)
        with suppress(OSError):
            _record().write_text(_installation(), encoding="utf-8")
        return failed


def compile_ahead(processes: int | None = None, progress: _Progress | None = None) -> int:
    """Compile all listed kernels, with a process for each core; returns how many could not be.

    `progress` is called with the numbers of finished and of all kernels.
    """
    # A kernel is compiled by one process for all its types: Numba's cache has one index for them.
    kernels: dict[str, list[list[Any]]] = {}
    for name, *types in json.loads(SIGNATURE_FILE.read_text(encoding="utf-8")):
        kernels.setdefault(name, []).append(types)
    import numba

    cores = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    pool = ProcessPoolExecutor(processes or cores, get_context("spawn"), _silence)
    compiled = 0
    try:
        jobs = [pool.submit(_compile, name, types) for name, types in kernels.items()]
        # Where a process ends in another way, what is left is compiled when it is called.
        with suppress(BrokenProcessPool):
            for done, job in enumerate(as_completed(jobs), 1):
                compiled += job.result()
                if progress is not None:
                    progress(done, len(jobs))
    finally:
        # Whoever interrupts this does not wait for kernels that are not begun.
        pool.shutdown(cancel_futures=True)
    return len(kernels) - compiled


def decode_type(entry: Any) -> Any:
    """A type of Numba from its entry: the name of a number, an array, or a (named) tuple."""
    from numba import types

    match entry:
        case str():
            return getattr(types, entry)
        case "array", number, axes, layout, writable:
            return types.Array(getattr(types, number), axes, layout, readonly=not writable)
        case "tuple", name, *members:
            made_by = None
            if name:
                module, _, kind = name.partition(":")
                made_by = getattr(import_module(module), kind)
            return types.BaseTuple.from_types([decode_type(one) for one in members], made_by)
    raise ValueError(f"an entry of {SIGNATURE_FILE.name} is no type: {entry!r}")


def _silence() -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def _compile(name: str, types: list[list[Any]]) -> bool:
    """Compile a kernel for each list of types, or load it from the cache.

    Returns whether that succeeded.
    """
    module, _, function = name.rpartition(".")
    # A kernel that cannot be compiled here is compiled when it is called, or raises its error then.
    with suppress(Exception):
        kernel = getattr(import_module(module), function)
        kernel = getattr(kernel, "kernel", kernel)
        for entries in types:
            kernel.compile(tuple(map(decode_type, entries)))
        record_checksums(kernel)
        return True
    return False


def _installation() -> str:
    """What compiled kernels depend on: this installation, its Python and its Numba."""
    return f"{sys.version} numba {version('numba')} {SIGNATURE_FILE.stat().st_mtime_ns}"


def _record() -> Path:
    """The file beside Numba's cache that names the installation that compiled the kernels."""
    from platformdirs import user_cache_path

    given = os.environ.get("NUMBA_CACHE_DIR")
    own = Path(__file__).parent / "__pycache__"
    if not given and not os.access(own if own.exists() else own.parent, os.W_OK):
        return user_cache_path("lfrender", ensure_exists=True) / "compiled.txt"
    folder = own
    if given:
        folder = Path(given)
    folder.mkdir(parents=True, exist_ok=True)
    return folder / "compiled.txt"
