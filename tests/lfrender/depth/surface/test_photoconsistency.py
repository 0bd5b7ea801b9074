"""The mismatch of views is that of whole patches, written out view by view."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from lfrender.depth.surface.photoconsistency import MAX_VIEWS, view_mismatch

RNG = np.random.default_rng(4)
IMAGE = RNG.random((60, 70)).astype(np.float32)
FLOOR = np.float32(0.01)


def _written_out(x_of, y_of, x, y, slope):
    """Mean mismatch of the better share of the views with the first or the second one, whichever is less."""
    side = np.arange(-1, 2)
    views = []
    for cx, cy in zip(x_of, y_of, strict=True):
        at = np.meshgrid(cy - (y - cy) * slope + side, cx - (x - cx) * slope + side, indexing="ij")
        views.append(map_coordinates(IMAGE.astype(float), at, order=1, mode="nearest").ravel())
    # Half of the others.
    number = {2: 1, 3: 1, 5: 2, 6: 3}[len(views)]
    best = []
    for r in range(2):
        costs = []
        for m, view in enumerate(views):
            if m != r:
                apart = view.var() + views[r].var() + (view.mean() - views[r].mean()) ** 2
                costs.append((((view - views[r]) ** 2).mean() + 0.5 * FLOOR) / (apart + FLOOR))
        best.append(np.mean(sorted(costs)[:number]))
    return min(best)


def _tried(x_of, y_of, x, y, slope, radius):
    near = np.array(x_of, np.float32), np.array(y_of, np.float32)
    place, half = np.float32([x, y, slope, radius]), np.float32(0.5)
    work = np.empty((MAX_VIEWS, 11), np.float32), np.empty(MAX_VIEWS, np.float32)
    return view_mismatch(IMAGE, *near, len(x_of), *place, FLOOR, half, *work)


@pytest.mark.parametrize("count", [2, 5, MAX_VIEWS])
def test_mismatch_is_that_of_the_better_share_of_the_views(count):
    for _ in range(20):
        x, y = RNG.uniform(25, 45), RNG.uniform(20, 40)
        x_of, y_of = x + RNG.uniform(-12, 12, count), y + RNG.uniform(-12, 12, count)
        slope = RNG.uniform(-0.5, 0.5)
        found, views = _tried(x_of, y_of, x, y, slope, 99)
        assert views == count
        assert found == pytest.approx(_written_out(x_of, y_of, x, y, slope), abs=2e-5)


def test_views_beyond_the_border_of_the_flat_are_those_a_pixel_inside():
    beyond, inside = ([0.2, 30.0], [25.0, 59.0]), ([1.0, 30.0], [25.0, 58.0])
    found = _tried(*beyond, 15.0, 40.0, 0.0, 99)[0]
    assert found == pytest.approx(_written_out(*inside, 15.0, 40.0, 0.0), abs=1e-3)


def test_lenses_that_do_not_reach_the_place_are_left_out():
    x_of, y_of = [30.0, 34.0, 55.0], [30.0, 30.0, 30.0]
    assert _tried(x_of, y_of, 31.0, 30.0, 0.5, 4.0)[1] == 2
    assert _tried(x_of[:1], y_of[:1], 31.0, 30.0, 0.5, 4.0) == (0.5, 1)
