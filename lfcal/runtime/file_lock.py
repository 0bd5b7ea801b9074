"""Locks on files: one process at a time, and a text that tells the others which one it is."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

try:
    import fcntl
except ImportError:  # Windows: processes do not wait for each other
    fcntl = None  # type: ignore[assignment]

__all__ = ["file_lock"]


@contextmanager
def file_lock(path: Path, wait: bool = False) -> Iterator[None]:
    """Lock a file, which is made, names this process, and is removed in the end.

    The system frees the lock when its process ends in any way: the file that a killed process has
    left is taken over. If another process has the lock, it is waited for, or there is a
    BlockingIOError that names this process. OSError if the file cannot be made.
    """
    stream = _lock(path, wait)
    try:
        yield
    finally:
        with suppress(OSError):
            path.unlink(missing_ok=True)
        stream.close()


def _lock(path: Path, wait: bool) -> TextIO:
    while True:
        stream = path.open("a+", encoding="utf-8")
        try:
            if fcntl is not None:
                fcntl.flock(stream, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            with stream:
                stream.seek(0)
                raise BlockingIOError(stream.read() or "another process") from error
        except OSError:  # A file system without locks
            return stream
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(stream.fileno()), path.stat()):
                stream.truncate(0)
                since = time.strftime("%Y-%m-%d %H:%M:%S")
                stream.write(f"process {os.getpid()} on {platform.node()} since {since}")
                stream.flush()
                return stream
        # The process before has removed the file.
        stream.close()
