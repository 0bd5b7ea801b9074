"""Compile kernels ahead, in one process per core."""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import chain
from queue import Empty, SimpleQueue

from .signatures import Signature, read_signatures

__all__ = ["compile_ahead", "remaining_stages", "signatures_of"]

# Set for the processes that compile: no more threads than one each.
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def remaining_stages(signature: Signature, packages: Iterable[str]) -> list[str]:
    """The first stage that needs a kernel, and those that follow it for the same kind of flat.

    Stages without kernels of `packages` are left out: they are those of another program.
    """
    known = read_signatures()
    first = next((stage for stage, entries in known.items() if signature in entries), None)
    if first is None:
        return []
    kind, names = first.partition(", ")[2], list(known)
    own = {stage: {entry.module.partition(".")[0] for entry in entries} for stage, entries in known.items()}
    following = [stage for stage in names[names.index(first) + 1 :] if stage.partition(", ")[2] == kind]
    return [first, *(stage for stage in following if own[stage] <= set(packages))]


def signatures_of(stages: Iterable[str]) -> list[Signature]:
    """The kernels of some stages, each once, the dearest of all first."""
    known = read_signatures()
    chosen = [known.get(stage, ()) for stage in stages]
    longest = max(map(len, chosen), default=0)
    ranked = chain.from_iterable(entries[place : place + 1] for place in range(longest) for entries in chosen)
    return list(dict.fromkeys(ranked))


def compile_ahead(
    signatures: Sequence[Signature],
    *,
    processes: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Compile kernels in several processes, which leave them in Numba's cache; returns how many could not be.

    Parameters
    ----------
    signatures : sequence of Signature
        See `signatures_of`. Those in the cache are only loaded.
    processes : int, optional
        By default one for each core, but not for fewer than three kernels each.
    progress : function of int and int, optional
        Called in this thread with the numbers of finished and of all kernels.
    """
    jobs: SimpleQueue[Signature] = SimpleQueue()
    for signature in signatures:
        jobs.put(signature)
    if not signatures:
        return 0
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    count = max(1, min(processes or cores, len(signatures) // 3 + 1))
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


def _run_process(jobs: SimpleQueue[Signature], done: SimpleQueue[bool | None]) -> None:
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
                    job = jobs.get_nowait()
                except Empty:
                    process.stdin.close()
                    break
                process.stdin.write(json.dumps(job) + "\n")
                process.stdin.flush()
                answer = process.stdout.readline()
                if not answer:
                    break
                done.put(answer.strip() == "compiled")
    finally:
        done.put(None)


def _serve() -> None:
    """The loop of a process that compiles: a kernel per line of stdin, a word per kernel on stdout."""
    # Nearly all that compiling makes lives as long as this process.
    gc.disable()
    # Numba looks for the linear algebra of SciPy, which takes long to import; no kernel uses it.
    sys.modules["scipy.linalg.cython_blas"] = None  # type: ignore[assignment]
    for line in sys.stdin:
        try:
            Signature(*json.loads(line)).compile()
            answer = "compiled"
        except Exception:
            answer = "failed"
        print(answer, flush=True)
