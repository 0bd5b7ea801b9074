"""Planes through the pairs of each lens: standard errors from their scatter."""

import numpy as np

from lfrender.depth.refinement.lens_plane import fit_lens_planes
from lfrender.depth.refinement.pair_fit import PairFits
from lfrender.flat.lens_graph import neighbour_rows


def test_scatter_of_pairs_raises_the_error_in_proportion(drawn_flat):
    gray, lattice, _truth, inner = drawn_flat(6.0)
    rows = neighbour_rows(lattice, lattice.steps)
    half = rows.shape[1] // 2
    start = np.full(len(rows), 6.0, np.float32)
    rng = np.random.default_rng(3)
    median = []
    for scatter in (0.02, 0.06):
        sizes = np.repeat(6.0 + scatter * rng.standard_normal((len(rows), half, 1)), 2, 2).astype(np.float32)
        sizes[rows[:, :half] < 0] = np.nan
        pairs = PairFits(sizes, np.full(sizes.shape, 0.02**2, np.float32), np.zeros((*sizes.shape, 2), np.float32))
        lenses = fit_lens_planes(gray, rows[:, :half], rows[:, half:], pairs, start)
        median.append(np.median(lenses.standard_error[inner]))
    # Three times the scatter, less outliers of the robust fit.
    assert 2.5 < median[1] / median[0] < 3
