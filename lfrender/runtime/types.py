"""Types that many signatures share."""

from __future__ import annotations

import os
from collections.abc import Callable

__all__ = ["AnyPath", "Progress", "Size"]

#: Path of a file or folder.
AnyPath = str | os.PathLike[str]
#: Is called with the number of finished parts, and of all parts.
Progress = Callable[[int, int], None]
#: Width and height, or rows and columns, as the name says.
Size = tuple[int, int]
