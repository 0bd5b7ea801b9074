"""How much more one lens type blurs than another, and how much less pairs scatter once that is known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from data_synth import SCENES, Camera, simulate
from lfrender.depth.refinement.defocus_difference import NO_DIFFERENCE, estimate_defocus_difference, sample_start_values
from lfrender.depth.refinement.restarts import refine_patch_sizes
from lfrender.flat.gray_flat import GrayFlat, make_gray_flat
from lfrender.flat.lens_graph import opposite_neighbours
from lfrender.runtime.cache import cached

RATIO, FOCUS = -0.4, (-0.1, 0.04, 0.18)


@cache
def flat(gamma: bool = True, focus: tuple[float, ...] | float = FOCUS):
    camera = Camera.design((420, 360), 23.2, focus=focus)
    return simulate(SCENES["plane"](camera, ratio=RATIO, seed=3), camera, samples=64, seed=3, gamma=gamma, bits=16)


def measured(kinds: bool, gamma: bool = True) -> tuple[np.ndarray, GrayFlat, np.ndarray]:
    """Errors of single lenses [px], the flat, and the true type of each lens."""
    shot = flat(gamma)
    gray = make_gray_flat(shot.flat, shot.truth.calibration)
    gray = replace(gray, lens_type=shot.truth.lens_type.astype(np.int8) if kinds else None)
    start = (shot.truth.patch_size + 0.2).astype(np.float32)
    halves = opposite_neighbours(shot.truth.calibration.lattice)
    alone = refine_patch_sizes(gray, *halves, start, np.full(len(start), np.nan), np.full(len(start), 0.1), 0.004, 5)
    inner = (np.abs(gray.centres - np.array([209.5, 179.5])) < np.array([150, 120])).all(1)
    return (alone.patch_size - shot.truth.patch_size)[inner], gray, shot.truth.lens_type


@pytest.mark.parametrize("gamma", [True, False])
def test_pairs_of_unlike_lenses_scatter_less_once_their_blur_is_known(gamma):
    before, *_ = measured(kinds=False, gamma=gamma)
    after, gray, _ = measured(kinds=True, gamma=gamma)
    assert np.sqrt(np.mean(after**2)) < 0.6 * np.sqrt(np.mean(before**2))
    blur = cached(gray, "blur", lambda: NO_DIFFERENCE)
    assert (blur.curve > 1) if gamma else (blur.curve < 0.5)


def test_lenses_focused_farther_from_the_scene_blur_more():
    _, gray, _ = measured(kinds=True)
    blur = cached(gray, "blur", lambda: NO_DIFFERENCE)
    more = blur.blurs + blur.growths * np.float32(RATIO * gray.pitch)
    np.testing.assert_array_equal(more, -more.T)
    # The first type is the sharpest: its Laplacian is taken away to make it like the others.
    assert more[0, 2] < more[0, 1] < -0.05 and more[1, 2] < -0.05


def test_types_without_known_pairs_get_no_difference():
    _, gray, kinds = measured(kinds=True)
    sizes = np.full((len(kinds), 3), np.nan, np.float32)
    forward, _ = opposite_neighbours(flat().truth.calibration.lattice)
    some = (kinds != 2) & (kinds[forward[:, 0]] != 2) & (forward[:, 0] >= 0)
    sizes[some, 0] = RATIO * gray.pitch
    blur = estimate_defocus_difference(
        gray.image,
        gray.centres,
        gray.radius - 1,
        gray.pitch,
        forward,
        sizes,
        np.full(len(kinds), 0.1),
        0.004,
        gray.lens_type,
    )
    assert blur.blurs.shape == (3, 3) and blur.blurs[0, 1] != 0
    assert (blur.blurs[2] == 0).all() and (blur.growths[2] == 0).all()
    nothing = estimate_defocus_difference(
        gray.image, gray.centres, gray.radius - 1, gray.pitch, forward, np.full_like(sizes, np.nan),
        np.full(len(kinds), 0.1), 0.004, gray.lens_type,
    )  # fmt: skip
    assert not nothing.blurs.any() and nothing.curve == 0


def test_a_sample_is_spread_over_the_lenses_with_a_start_value():
    start = np.where(np.arange(5000) % 2, np.float32(3.0), np.float32(np.nan))
    some = np.flatnonzero(np.isfinite(sample_start_values(start)))
    assert 100 < len(some) < 300 and (some % 2 == 1).all()
    assert np.histogram(some, 10, (0, 5000))[0].min() > 8
    np.testing.assert_array_equal(sample_start_values(start[:40]), start[:40])
