"""Patch sizes of lenses refined from several starts."""

import numpy as np

from lfrender.depth.refinement.restarts import refine_patch_sizes
from lfrender.flat.lens_graph import neighbour_rows


def measured(gray, lattice, start, second=np.nan):
    rows = neighbour_rows(lattice, lattice.steps)
    half = rows.shape[1] // 2
    scale = np.full(len(start), 0.1, np.float32)
    second = np.broadcast_to(np.float32(second), len(start))
    return refine_patch_sizes(gray, rows[:, :half], rows[:, half:], start.astype(np.float32), second, scale, 0.005, 6)


def test_a_lens_takes_the_second_best_match_if_its_pairs_agree_on_it(drawn_flat):
    gray, lattice, truth, inner = drawn_flat(-8.0, detail=1.0)
    false = inner & (np.arange(len(truth)) % 7 == 0)
    start = np.where(false, 7.0, truth)
    assert (np.abs(measured(gray, lattice, start).patch_size + 8.0)[false] > 1).all()
    lenses = measured(gray, lattice, start, np.where(false, -8.2, 7.0))
    assert (np.abs(lenses.patch_size + 8.0)[inner] < 0.1).mean() > 0.99


def test_lenses_on_the_other_side_of_a_depth_edge_have_no_influence(drawn_flat):
    left, lattice, _, inner = drawn_flat(-6.0)
    right = drawn_flat(-7.2, seed=6)[0]
    nearer = np.arange(left.image.shape[1]) < 210
    image = np.where(nearer, left.image, right.image)
    gray = type(left)(np.ascontiguousarray(image), left.centres, left.radius, left.pitch)
    truth = np.where(left.centres[:, 0] < 210, -6.0, -7.2)
    # Microimages that the border of the two drawings does not cut.
    whole = inner & (np.abs(left.centres[:, 0] - 210) > 12)
    lenses = measured(gray, lattice, truth)
    error = np.abs(lenses.patch_size - truth)[whole]
    assert np.median(error) < 0.01
    assert np.quantile(error, 0.97) < 0.1
