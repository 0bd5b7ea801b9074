"""OpenCV without lines of its own on the terminal: what is wrong is said once, by this program."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["set_opencv_log", "silent_opencv"]


def set_opencv_log(level: int) -> int:
    """Set what OpenCV reports, 0 is nothing; returns what it was."""
    import cv2

    # Since OpenCV 4.13 the functions are in a module of their own.
    log = getattr(cv2.utils, "logging", cv2)
    before: int = log.getLogLevel()
    log.setLogLevel(level)
    return before


@contextmanager
def silent_opencv() -> Iterator[None]:
    """Let OpenCV report nothing itself."""
    before = set_opencv_log(0)
    try:
        yield
    finally:
        set_opencv_log(before)
