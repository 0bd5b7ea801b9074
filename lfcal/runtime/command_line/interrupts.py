"""Ctrl-C ends a command within seconds, wherever it lands.

Python raises KeyboardInterrupt between any two steps of the main thread, so also while the lock of
a future is held: a worker then waits for the lock for ever, and the interpreter, as it exits, for
the worker. A command that was interrupted therefore unwinds for at most `GRACE` seconds, and leaves
without joining threads.
"""

from __future__ import annotations

import contextlib
import faulthandler
import os
import signal
import sys
from collections.abc import Iterator
from types import FrameType

from ..output_file import discard_unfinished

__all__ = ["GRACE", "INTERRUPTED", "end_by_interrupt", "handle_interrupts", "leave_if_interrupted"]

#: Seconds that a command has after Ctrl-C to clean up; a second Ctrl-C ends it at once.
GRACE = 3.0
INTERRUPTED = 130  # 128 and the number of the signal, as shells say it

_interrupted = False


def handle_interrupts() -> None:
    """Let the first Ctrl-C raise KeyboardInterrupt within a time limit, unless it is ignored."""
    with contextlib.suppress(ValueError):  # not in the main thread
        if signal.getsignal(signal.SIGINT) in (signal.default_int_handler, signal.SIG_DFL):
            signal.signal(signal.SIGINT, _interrupt)


@contextlib.contextmanager
def end_by_interrupt() -> Iterator[None]:
    """Let Ctrl-C end the work inside, such as serving a page; the code after it runs on."""
    global _interrupted
    try:
        yield
    except KeyboardInterrupt:
        _interrupted = False
        faulthandler.cancel_dump_traceback_later()
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0)


def leave_if_interrupted(code: int) -> None:
    """End an interrupted process at once with an exit code, without joining its threads."""
    if _interrupted:
        _leave(code)


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _interrupted
    if _interrupted:
        _leave(INTERRUPTED)
    _interrupted = True
    # A timer of the system, as a thread could not be started where a lock of `threading` is held.
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, lambda *_: _leave(INTERRUPTED))
        signal.setitimer(signal.ITIMER_REAL, GRACE)
    # Where the main thread is in a long kernel it handles no signal.
    with contextlib.suppress(OSError, ValueError):
        faulthandler.dump_traceback_later(GRACE + 1, exit=True, file=open(os.devnull, "w"))  # noqa: SIM115
    signal.default_int_handler(number, frame)


def _leave(code: int) -> None:
    discard_unfinished()
    if "multiprocessing.process" in sys.modules:
        from multiprocessing.process import active_children

        for child in active_children():
            child.kill()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, RuntimeError, AttributeError):
            stream.flush()
    os._exit(code)
