"""Which pixels of a picture are drawn again after an earlier frame: those in which some changed lens takes part."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from lfcal.runtime.fastmath import FAST

from ..data.surface import Surface, mark_changed_places
from .plan import RenderPlan

__all__ = ["find_changed_pixels"]


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _mark_pixels(places, side, strip, out):
    """Set `out` no farther than `side` from `places` (m, 2) in it, `strip` rows of it at a time, and unset the rest."""
    rows, columns = out.shape
    for s in prange((rows + strip - 1) // strip):
        top, bottom = s * strip, min(rows, (s + 1) * strip)
        # How many more lenses reach a pixel than the one to its left.
        more = np.zeros((bottom - top, columns + 1), np.int32)
        for n in range(len(places)):
            x, y = places[n, 0], places[n, 1]
            if y + side < top or y - side > bottom:
                continue
            for v in range(max(top, int(np.ceil(y - side))), min(bottom - 1, int(np.floor(y + side))) + 1):
                half = np.sqrt(max(side * side - (v - y) * (v - y), 0.0))
                left, right = max(0, int(np.ceil(x - half))), min(columns, int(np.floor(x + half)) + 1)
                if left < right:
                    more[v - top, left] += 1
                    more[v - top, right] -= 1
        for v in range(top, bottom):
            reached = 0
            for u in range(columns):
                reached += more[v - top, u]
                out[v, u] = reached > 0


def find_changed_pixels(drawing: RenderPlan, before: Surface, changed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(rows, columns) bool: pixels of the picture that may differ from those of an earlier frame.

    They are read from a lens that shows something else, or from one in reach of which the depth is another, so that
    what hides what may have changed in it. All others would be drawn from the same depth and pixels.

    Parameters
    ----------
    drawing : Drawing
        Of the frame, all in focus.
    before : Surface
        Of the earlier frame.
    changed : (n,) bool
        Lenses that show something else.
    """
    columns, rows = drawing.size
    lattice, now = drawing.calibration.lattice, drawing.surface
    if before.patch_size.shape != now.patch_size.shape or before.first != now.first or before.spacing != now.spacing:
        return np.ones((rows, columns), bool)
    centres = lattice.centres()
    reach = drawing.reach * lattice.pitch
    stale = changed.copy()
    # A place between grid values depends on all four of them.
    mark_changed_places(before, now, centres, reach + 1.5 * now.spacing, stale)
    wanted = np.empty((rows, columns), bool)
    # Pixels are read at several places where patches are larger, all of them within the pixel.
    farthest = reach + drawing.spacing
    places = (centres[stale] - (0.5 * drawing.spacing - 0.5)) / drawing.spacing
    _mark_pixels(places, farthest / drawing.spacing, 16, wanted)
    return wanted
