"""OpenCV without lines of its own on the terminal: what is wrong is said once, by this program."""

from __future__ import annotations

__all__ = ["set_opencv_log"]


def set_opencv_log(level: int) -> None:
    """Set what OpenCV reports, 0 is nothing."""
    import cv2

    # Since OpenCV 4.13 the function is in a module of its own.
    getattr(cv2.utils, "logging", cv2).setLogLevel(level)
