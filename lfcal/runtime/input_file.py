"""Read text files from unknown sources: regular files only, of limited size."""

from __future__ import annotations

import os
import stat
from io import BytesIO, TextIOWrapper
from json import detect_encoding

from .arrays import LARGEST_BLOCK
from .errors import check_path
from .types import AnyPath

__all__ = ["LARGEST_TEXT", "open_regular", "read_text"]

#: Of camera files [bytes]: a table of the three million microimages of a flat of 500 megapixels has
#: half of it.
LARGEST_TEXT = LARGEST_BLOCK


def open_regular(path: AnyPath) -> int:
    """Open a regular file for reading and return its descriptor.

    OSError for other files. A pipe without a writer is not waited for.

    Examples
    --------
    >>> open_regular(os.devnull)
    Traceback (most recent call last):
    OSError: is no regular file but a device, a pipe or a folder
    """
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    descriptor = os.open(check_path(path), flags)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError("is no regular file but a device, a pipe or a folder")
    return descriptor


def read_text(path: AnyPath) -> str:
    """The text of a file in UTF-8, UTF-16 or UTF-32, with or without a byte order mark.

    OSError if it has more than `LARGEST_TEXT` bytes.
    """
    with open(open_regular(path), "rb") as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > LARGEST_TEXT:
            raise OSError(f"has {size / 1e6:,.0f} MB, more than any such file")
        data = stream.read()
    with TextIOWrapper(BytesIO(data), detect_encoding(data)) as text:
        return text.read()
