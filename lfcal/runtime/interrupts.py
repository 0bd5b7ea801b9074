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
from importlib import import_module
from types import FrameType

from .output_file import discard_unfinished

__all__ = ["GRACE", "end_by_interrupt", "handle_interrupts", "leave_if_interrupted", "run_program"]

#: Seconds that a command has after Ctrl-C to put away what it works on; after a second Ctrl-C it
#: has none.
GRACE = 3.0
_CODE = 130  # 128 and the number of the signal, as shells say it

_interrupted = False


def run_program(name: str) -> None:
    """Load the command line of the package `name`, and run it; an interrupt meanwhile ends the
    process.
    """
    handle_interrupts()
    try:
        main = import_module(f"{name}.cli.main").main
    except BaseException:
        leave_if_interrupted(_CODE)
        raise
    main(prog_name=name)


def handle_interrupts() -> None:
    """Let the first Ctrl-C from now on raise KeyboardInterrupt, with the limit; nothing where it is
    ignored.
    """
    with contextlib.suppress(ValueError):  # not in the main thread
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, _interrupt)


@contextlib.contextmanager
def end_by_interrupt() -> Iterator[None]:
    """Work that Ctrl-C ends as it should, such as serving a page: what follows, a recording for
    one, has time.
    """
    global _interrupted
    try:
        yield
    except KeyboardInterrupt:
        _interrupted = False
        faulthandler.cancel_dump_traceback_later()
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0)


def leave_if_interrupted(code: int) -> None:
    """End the process at once, with an exit code, if it was interrupted; threads are not waited
    for.
    """
    if _interrupted:
        _leave(code)


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _interrupted
    if _interrupted:
        _leave(_CODE)
    _interrupted = True
    # A timer of the system, as a thread could not be started where a lock of `threading` is held.
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, lambda *_: _leave(_CODE))
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
