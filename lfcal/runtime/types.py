"""Types that many signatures share."""

from __future__ import annotations

import os
from typing import Any

__all__ = ["AnyPath", "Entries", "Page", "Size"]

#: Path of a file or folder.
AnyPath = str | os.PathLike[str]
#: Width and height [px].
Size = tuple[int, int]
#: Number of a picture in a file; None is the only one.
Page = int | None
#: Values by name: figures of a result, tables of a file.
Entries = dict[str, Any]
