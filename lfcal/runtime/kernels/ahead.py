"""Compile kernels ahead, in one process per core, which leave them in Numba's cache."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path

from .signatures import SIGNATURE_FILE, Signature, read_signatures

try:
    import fcntl
except ImportError:  # Windows: processes compile side by side
    fcntl = None  # type: ignore[assignment]

__all__ = ["compile_ahead", "compile_once", "is_compiled"]

_Progress = Callable[[int, int], None]


def is_compiled() -> bool:
    """Whether `compile_once` has been run for this installation."""
    try:
        return _record().read_text(encoding="utf-8") == _installation()
    except OSError:
        return False


def compile_once(*, processes: int | None = None, progress: _Progress | None = None) -> int:
    """Compile all listed kernels and record it; returns how many could not be.

    Processes that call this at the same time wait for the first one. Arguments are those of `compile_ahead`.
    """
    with _lock():
        if is_compiled():
            return 0
        failed = compile_ahead(read_signatures(), processes=processes, progress=progress)
        # A folder that cannot be written to holds no kernels either.
        with suppress(OSError):
            _record().write_text(_installation(), encoding="utf-8")
        return failed


def compile_ahead(
    signatures: Sequence[Signature], *, processes: int | None = None, progress: _Progress | None = None
) -> int:
    """Compile kernels in several processes; returns how many could not be.

    Parameters
    ----------
    signatures : sequence of Signature
        See `read_signatures`. Those in the cache are only loaded.
    processes : int, optional
        By default one for each core.
    progress : function of int and int, optional
        Called in this thread with the numbers of finished and of all kernels.
    """
    # A kernel is compiled by one process for all its types: Numba's cache has one index for them.
    kernels: dict[tuple[str, str], list[Signature]] = {}
    for signature in signatures:
        kernels.setdefault((signature.module, signature.name), []).append(signature)
    if not kernels:
        return 0
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    count = max(1, min(processes or cores, len(kernels)))
    finished = compiled = 0
    # A process that ends in another way takes the rest with it: those kernels are compiled when they are called.
    pool = ProcessPoolExecutor(count, get_context("spawn"), _prepare_process)
    try:
        for job in as_completed([pool.submit(_compile, same) for same in kernels.values()]):
            for fine in job.result():
                finished += 1
                compiled += fine
                if progress is not None:
                    progress(finished, len(signatures))
    except BrokenProcessPool:
        pass
    finally:
        # Whoever interrupts this does not wait for kernels that are not begun.
        pool.shutdown(cancel_futures=True)
    return len(signatures) - compiled


def _prepare_process() -> None:
    """One thread for each process, and no remarks of compilers."""
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def _compile(signatures: list[Signature]) -> list[bool]:
    """Compile one kernel for all its types; tells which of them could be."""
    fine = []
    for signature in signatures:
        try:
            signature.compile()
            fine.append(True)
        except Exception:
            fine.append(False)
    return fine


def _installation() -> str:
    """What compiled kernels depend on: this installation, its Python and its Numba."""
    return f"{sys.version} numba {version('numba')} {SIGNATURE_FILE.stat().st_mtime_ns}"


def _record() -> Path:
    """The file that tells for which installation the kernels were compiled, where Numba's cache is."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    own = Path(given) if given else Path(__file__).parent / "__pycache__"
    if given or os.access(own if own.exists() else own.parent, os.W_OK):
        own.mkdir(parents=True, exist_ok=True)
        return own / "compiled.txt"
    from platformdirs import user_cache_path

    return user_cache_path("lfrender", ensure_exists=True) / "compiled.txt"


@contextmanager
def _lock() -> Iterator[None]:
    """Wait while another process compiles; the system frees the lock of one that ends in any way."""
    if fcntl is None:
        yield
        return
    try:
        file = _record().with_suffix(".lock").open("w")
    except OSError:
        yield
        return
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
