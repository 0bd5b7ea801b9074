"""Average cells of tiles, against a plain sum over their pixels."""

from __future__ import annotations

import numpy as np

from lfcal.detection.folding import fold_tiles


def test_folds_average_the_pixels_of_a_tile_by_their_position_in_the_cell():
    rng = np.random.default_rng(3)
    bins = 12
    picture = rng.standard_normal((130, 170)).astype(np.float32)
    basis = np.array([[18.6, 0.3], [9.1, 16.2]])
    (folds,) = fold_tiles([picture], basis, 50, bins)
    first, second = fold_tiles([-picture, picture], basis, 50, bins)
    y, x = np.mgrid[: folds.side, : folds.side].reshape(2, -1)
    place = np.column_stack([x + folds.side, y]) @ np.linalg.inv(basis)
    column, row = (((place - np.floor(place)) * bins).astype(int) % bins).T
    total, count = np.zeros((2, bins, bins))
    np.add.at(total, (row, column), picture[y, x + folds.side])
    np.add.at(count, (row, column), 1)
    # The second tile of the first row.
    np.testing.assert_array_equal(folds.count[1], count)
    np.testing.assert_allclose(folds.total[1], total, atol=1e-4)
    assert folds.count.sum() == picture.size
    # Two pictures at once are folded as each by itself.
    for both, single in (
        (first.total, -folds.total),
        (second.total, folds.total),
        (second.count, folds.count),
    ):
        np.testing.assert_array_equal(both, single)
