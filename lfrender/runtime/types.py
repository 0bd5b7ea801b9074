"""Types that many signatures share."""

from __future__ import annotations

import os

__all__ = ["AnyPath", "Size"]

#: Path of a file or folder.
AnyPath = str | os.PathLike[str]
#: Width and height, or rows and columns, as the name says.
Size = tuple[int, int]
