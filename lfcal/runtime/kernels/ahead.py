"""Compile kernels ahead, in one process per core, which leave them in Numba's cache."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from queue import Empty, SimpleQueue

from .signatures import SIGNATURE_FILE, Signature, read_signatures

try:
    import fcntl
except ImportError:  # Windows: processes compile side by side
    fcntl = None  # type: ignore[assignment]

__all__ = ["compile_ahead", "compile_once", "is_compiled"]

# Set for the processes that compile: no more threads than one each.
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
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
    if not signatures:
        return 0
    # A kernel is compiled by one process for all its types: Numba's cache has one index for them.
    kernels: dict[tuple[str, str], list[Signature]] = {}
    for signature in signatures:
        kernels.setdefault((signature.module, signature.name), []).append(signature)
    jobs: SimpleQueue[list[Signature]] = SimpleQueue()
    for same in kernels.values():
        jobs.put(same)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    count = max(1, min(processes or cores, len(kernels)))
    done: SimpleQueue[bool | None] = SimpleQueue()
    failed = finished = ended = 0
    with ThreadPoolExecutor(count) as threads:
        for _ in range(count):
            threads.submit(_run_process, jobs, done)
        while ended < count:
            result = done.get()
            if result is None:
                ended += 1
                continue
            finished += 1
            failed += not result
            if progress is not None:
                progress(finished, len(signatures))
    return failed + len(signatures) - finished


def _run_process(jobs: SimpleQueue[list[Signature]], done: SimpleQueue[bool | None]) -> None:
    """Feed one process with kernels, one at a time, so that no process is left with the last few dear ones."""
    environment = {**os.environ, **dict.fromkeys(_ONE_THREAD, "1")}
    # The packages of this process, wherever they are.
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    try:
        with suppress(OSError), subprocess.Popen(
            [sys.executable, "-P", "-c", f"from {__name__} import _serve; _serve()"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment,
        ) as process:  # fmt: skip
            assert process.stdin is not None and process.stdout is not None
            while True:
                try:
                    kernel = jobs.get_nowait()
                except Empty:
                    process.stdin.close()
                    return
                for signature in kernel:
                    process.stdin.write(json.dumps(signature) + "\n")
                    process.stdin.flush()
                    answer = process.stdout.readline()
                    if not answer:
                        return
                    done.put(answer.strip() == "compiled")
    finally:
        done.put(None)


def _serve() -> None:
    """The loop of a process that compiles: a kernel per line of stdin, a word per kernel on stdout."""
    for line in sys.stdin:
        try:
            Signature(*json.loads(line)).compile()
            answer = "compiled"
        except Exception:
            answer = "failed"
        print(answer, flush=True)


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
