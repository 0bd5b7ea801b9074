"""Planes through the pairs of each lens: standard errors from their scatter."""

import numpy as np

from lfrender.depth.refinement.lens_plane import fit_lens_planes
from lfrender.depth.refinement.pair_fit import PairFits, fit_pairs
from lfrender.flat.neighbours import neighbours_of


def test_scatter_of_pairs_raises_the_error_in_proportion(drawn_flat):
    gray, lattice, _truth, inner = drawn_flat(6.0)
    neighbours = neighbours_of(lattice)
    half = neighbours.forward.shape[1]
    start = np.full(len(lattice), 6.0, np.float32)
    rng = np.random.default_rng(3)
    median = []
    for scatter in (0.02, 0.06):
        sizes = np.repeat(
            6.0 + scatter * rng.standard_normal((len(lattice), half, 1)), 2, 2
        ).astype(np.float32)
        sizes[neighbours.forward < 0] = np.nan
        pairs = PairFits(
            sizes,
            np.full(sizes.shape, 0.02**2, np.float32),
            np.zeros((*sizes.shape, 2), np.float32),
        )
        lenses = fit_lens_planes(gray, neighbours, pairs, start)
        median.append(np.median(lenses.standard_error[inner]))
    # Three times the scatter, less outliers of the robust fit.
    assert 2.5 < median[1] / median[0] < 3


def test_lenses_on_the_other_side_of_a_depth_edge_have_no_influence(drawn_flat):
    left, lattice, _, inner = drawn_flat(-6.0)
    right = drawn_flat(-7.2, seed=6)[0]
    nearer = np.arange(left.image.shape[1]) < 210
    image = np.where(nearer, left.image, right.image)
    gray = type(left)(np.ascontiguousarray(image), left.centres, left.radius, left.pitch)
    truth = np.where(left.centres[:, 0] < 210, -6.0, -7.2)
    # Microimages that the border of the two drawings does not cut.
    whole = inner & (np.abs(left.centres[:, 0] - 210) > 12)
    neighbours = neighbours_of(lattice)
    start = truth.astype(np.float32)
    pairs = fit_pairs(
        gray, neighbours.forward, start, np.full(len(start), 0.1, np.float32), 0.005, 6
    )
    lenses = fit_lens_planes(gray, neighbours, pairs, start)
    error = np.abs(lenses.patch_size - truth)[whole]
    assert np.median(error) < 0.01
    assert np.quantile(error, 0.97) < 0.1
