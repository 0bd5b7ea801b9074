"""Patch sizes of pairs, and planes through the pairs of each lens."""

import dataclasses

import numpy as np

from lfrender.depth.refinement.lens_plane import fit_lens_planes
from lfrender.depth.refinement.pair_fit import fit_pairs
from lfrender.flat.neighbours import neighbours_of


def measure(gray, lattice, start, noise=0.005, iterations=8, scale=0.1):
    neighbours = neighbours_of(lattice)
    scale = np.full(len(start), scale, np.float32)
    pairs = fit_pairs(gray, neighbours.forward, start.astype(np.float32), scale, noise, iterations)
    return pairs, fit_lens_planes(gray, neighbours, pairs, start.astype(np.float32))


def test_pairs_of_a_plane_have_no_common_error_at_any_fraction_of_a_pixel(drawn_flat):
    for s in (-6.13, -5.37, 5.31, 6.84):
        gray, lattice, truth, inner = drawn_flat(s)
        pairs, _ = measure(gray, lattice, truth + 0.4)
        error = np.nanmedian(pairs.patch_size[inner, :, 0] - s, axis=0)
        assert np.abs(error).max() < 0.005, (
            f"{s} px: off by {error} px along the lattice directions"
        )


def test_each_lens_of_a_slanted_plane_measures_its_own_centre(drawn_flat):
    gray, lattice, truth, inner = drawn_flat(-6.5, slant=(0.03, -0.02))
    assert np.ptp(truth[inner]) > 1.5
    _, lenses = measure(gray, lattice, truth + 0.3)
    error = np.abs(lenses.patch_size - truth)[inner]
    assert np.median(error) < 0.004
    assert np.quantile(error, 0.95) < 0.03
    at = np.argmin(np.abs(gray.centres - 0.5 * np.array(gray.image.shape[::-1])).sum(1))
    np.testing.assert_allclose(lenses.slant[at], (0.03, -0.02), atol=0.003)


def test_two_thirds_of_the_lenses_lie_within_their_standard_error(drawn_flat):
    for noise in (0.01, 0.03):
        gray, lattice, truth, inner = drawn_flat(-6.5, noise=noise, detail=0.8)
        _, lenses = measure(gray, lattice, truth)
        within = (np.abs(lenses.patch_size - truth) < lenses.standard_error)[inner].mean()
        assert 0.58 < within < 0.8, f"noise {noise}: {within:.2f}"


def test_neighbours_on_two_surfaces_are_fitted_from_both_sides(drawn_flat):
    gray, lattice, _truth, inner = drawn_flat(-6.0)
    start = np.where(gray.centres[:, 0] < 200, -6.0, 6.0).astype(np.float32)
    pairs, _ = measure(gray, lattice, start)
    across = neighbours_of(lattice).forward[:, 0]
    edge = inner & (start < 0) & (start[across] > 0)
    assert edge.sum() >= 8
    assert np.abs(pairs.patch_size[edge, 0, 0] + 6.0).max() < 0.05
    assert not (pairs.patch_size[edge, 0, 1] < 0).any()


def test_lenses_without_a_start_value_are_left_out(drawn_flat):
    gray, lattice, truth, inner = drawn_flat(5.0)
    start = np.where(np.arange(len(truth)) % 2, truth, np.nan)
    _, lenses = measure(gray, lattice, start)
    assert np.isnan(lenses.patch_size[::2]).all()
    assert np.isinf(lenses.standard_error[::2]).all()
    assert np.isfinite(lenses.patch_size[1::2][inner[1::2]]).all()


def test_slopes_of_noise_do_not_bias_a_fit_toward_its_start(drawn_flat):
    gray, lattice, truth, inner = drawn_flat(-6.5, noise=0.06, detail=0.4)
    error = {}
    for known in (0.06, 0.0):
        _, lenses = measure(gray, lattice, truth + 1.0, known, 5, scale=0.3)
        error[known] = np.median((lenses.patch_size - truth)[inner])
        within = (np.abs(lenses.patch_size - truth) < lenses.standard_error)[inner].mean()
        assert known == 0 or 0.58 < within < 0.8
    assert abs(error[0.06]) < 0.025 < 0.04 < error[0.0], f"off by {error} px"


def test_shading_left_in_microimages_hardly_moves_their_pairs(drawn_flat):
    gray, lattice, truth, inner = drawn_flat(-12.0, detail=0.5)
    y, x = np.mgrid[: gray.image.shape[0], : gray.image.shape[1]]
    points = np.column_stack([x.ravel(), y.ravel()])
    delta = points - lattice.origin - np.rint(lattice.to_index(points)) @ lattice.basis
    rim = 1 - 0.02 * (delta**2).sum(1).reshape(x.shape) / gray.radius**2
    shaded = dataclasses.replace(gray, image=(gray.image * rim).astype(np.float32))
    error = [
        np.median(np.abs(measure(flat, lattice, truth)[1].patch_size - truth)[inner])
        for flat in (gray, shaded)
    ]
    assert error[1] < 1.3 * error[0] + 0.004, f"{error} px without and with shading"
