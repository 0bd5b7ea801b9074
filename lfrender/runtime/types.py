"""Types that many signatures share."""

from __future__ import annotations

from lfcal.runtime.types import AnyPath, Entries, Size

__all__ = ["AnyPath", "Entries", "Place", "Region", "Size", "Triple"]

#: Two numbers, x before y: a place, a viewpoint; or both ends of a range.
Place = tuple[float, float]
#: Opposite corners `x0, y0, x1, y1` of a part of a flat [px].
Region = tuple[float, float, float, float]
#: Three numbers: of red, green and blue, or along three axes.
Triple = tuple[float, float, float]
