"""Types that many signatures share."""

from __future__ import annotations

import os
from typing import Any

__all__ = ["AnyPath", "Entries", "Place", "Region", "Size", "Triple"]

#: Path of a file or folder.
AnyPath = str | os.PathLike[str]
#: Width and height, or rows and columns, as the name says.
Size = tuple[int, int]
#: Two numbers, x before y: a place, a viewpoint; or both ends of a range.
Place = tuple[float, float]
#: Opposite corners `x0, y0, x1, y1` of a part of a flat [px].
Region = tuple[float, float, float, float]
#: Three numbers: of red, green and blue, or along three axes.
Triple = tuple[float, float, float]
#: Values by name: options of a call, settings of a picture, figures of a result.
Entries = dict[str, Any]
