"""Patch sizes of pairs, and planes through the pairs of each lens."""

import dataclasses

import numpy as np
import pytest

from lfrender.depth.refinement.least_squares import geman_mcclure
from lfrender.depth.refinement.lens_plane import fit_lens_planes
from lfrender.depth.refinement.pair_fit import _NO_LIGHT, fit_pairs
from lfrender.flat.gray_flat import GrayFlat
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


# Five lenses in a cross: the middle one, and those right, below, left and above of it.
CENTRES = np.array([[45.3, 44.8], [69.1, 45.4], [44.7, 68.6], [21.5, 44.2], [45.9, 21.0]])
PITCH = 23.81
# Pairs of the middle lens with the four others, one direction each.
FROM_MIDDLE = np.full((5, 4), -1, np.int32)
FROM_MIDDLE[0] = 1, 2, 3, 4
# The same pairs, seen from the other lenses.
FROM_OTHERS = np.full((5, 4), -1, np.int32)
FROM_OTHERS[[1, 2, 3, 4], [0, 1, 2, 3]] = 0


def cross(s, blurred=False):
    """A grey flat of the five lenses before waves on a plane, drawn by hand; three of them may be
    blurred.
    """
    y, x = np.mgrid[:91, :91].astype(float)
    points = np.stack([x, y], -1)
    away = points[:, :, None] - CENTRES
    lens = np.square(away).sum(-1).argmin(-1)
    scene = CENTRES[lens] - (points - CENTRES[lens]) * PITCH / s
    kinds = np.array([0, 1, 0, 1, 1] if blurred else [0] * 5, np.int8)
    image = np.full(x.shape, 0.5)
    rng = np.random.default_rng(3)
    for _ in range(40):
        wave = rng.uniform(-0.9, 0.9, 2) * abs(s) / PITCH
        # In pixels of the flat a wave has this frequency; blur of a variance of 0.3 px^2 weakens it.
        frequency2 = np.square(wave).sum() * (PITCH / s) ** 2
        height = np.exp(-0.5 * 0.3 * frequency2 * kinds[lens])
        image += 0.02 * height * np.cos(scene @ wave + rng.uniform(0, 2 * np.pi))
    return GrayFlat(
        image.astype(np.float32),
        CENTRES.astype(np.float32),
        11.2,
        PITCH,
        kinds if blurred else None,
    )


def turned(gray, across, down):
    """The same flat mirrored in `x` if `across`, and in `y` if `down`."""
    image = gray.image[:: -1 if down else 1, :: -1 if across else 1]
    last = np.array(gray.image.shape[::-1], np.float32) - 1
    centres = np.where([across, down], last - gray.centres, gray.centres).astype(np.float32)
    return dataclasses.replace(gray, image=np.ascontiguousarray(image), centres=centres)


def fit_cross(gray, rows, start):
    every = np.full(5, start, np.float32)
    return fit_pairs(gray, rows, every, np.full(5, 0.1, np.float32), 0.003, 12, 1e-4)


@pytest.mark.parametrize("blurred", [False, True], ids=["alike", "two types"])
@pytest.mark.parametrize("s", [-7.3, 5.6])
def test_each_pair_of_five_lenses_has_the_shift_it_was_drawn_with(s, blurred):
    fits = fit_cross(cross(s, blurred), FROM_MIDDLE, s + 0.5)
    measured = fits.patch_size[0, :, 0]
    np.testing.assert_allclose(measured, s, atol=0.02 if blurred else 0.006)
    assert (fits.variance[0, :, 0] < 0.02**2).all()
    # Both microimages show places about the middle of both.
    assert np.abs(fits.place[0, :, 0]).max() < 4
    assert np.isnan(fits.patch_size[1:]).all()


@pytest.mark.parametrize("blurred", [False, True], ids=["alike", "two types"])
@pytest.mark.parametrize("s", [-7.3, 5.6])
def test_exchanged_lenses_measure_the_same_patch_size(s, blurred):
    gray = cross(s, blurred)
    there = fit_cross(gray, FROM_MIDDLE, s)
    back = fit_cross(gray, FROM_OTHERS, s)
    lens = [1, 2, 3, 4]
    direction = [0, 1, 2, 3]
    np.testing.assert_allclose(
        back.patch_size[lens, direction], there.patch_size[0], atol=0.02 if blurred else 0.006
    )
    np.testing.assert_allclose(back.place[lens, direction], there.place[0], atol=0.5)


@pytest.mark.parametrize("blurred", [False, True], ids=["alike", "two types"])
@pytest.mark.parametrize(
    ("across", "down"), [(True, False), (False, True), (True, True)], ids=["x", "y", "half a turn"]
)
def test_a_mirrored_or_turned_flat_has_the_same_patch_sizes(across, down, blurred):
    gray = cross(-6.4, blurred)
    first = fit_cross(gray, FROM_MIDDLE, -6.0)
    second = fit_cross(turned(gray, across, down), FROM_MIDDLE, -6.0)
    np.testing.assert_allclose(second.patch_size[0], first.patch_size[0], atol=2e-4)
    np.testing.assert_allclose(second.variance[0], first.variance[0], rtol=0.01)
    signs = np.where([across, down], -1, 1)
    np.testing.assert_allclose(second.place[0] * signs, first.place[0], atol=0.01)


def test_the_blur_of_a_lens_type_is_no_shift():
    gray = cross(-7.3, blurred=True)
    known = fit_cross(gray, FROM_MIDDLE, -7.0)
    unknown = fit_cross(dataclasses.replace(gray, lens_type=None), FROM_MIDDLE, -7.0)
    # Directions 0, 2 and 3 lead to lenses of the other type.
    other = [0, 2, 3]
    assert (known.variance[0, other, 0] < 0.7 * unknown.variance[0, other, 0]).all()


def test_hidden_pixels_have_no_weight_at_all():
    # Subnormal products make a fit thirty times as long; noise of a flat is far below white.
    for scale in (0.001, 0.1, 1.0):
        assert geman_mcclure(_NO_LIGHT * _NO_LIGHT, np.float32(scale * scale)) == 0.0
