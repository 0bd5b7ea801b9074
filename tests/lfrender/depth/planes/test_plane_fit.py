"""The robust fit of a plane to patch sizes."""

from __future__ import annotations

import numpy as np

from lfrender.depth.planes.plane_fit import fit_plane


def test_a_surface_bent_by_a_tenth_of_a_pixel_is_no_plane():
    rng = np.random.default_rng(3)
    points = rng.uniform(0, 600, (400, 2))
    flat = 1 / (1 / 7 + 2e-5 * points[:, 0]) + rng.normal(0, 0.03, 400)
    bent = flat + 0.1 * np.cos(points[:, 0] / 150)
    plane_found = fit_plane(points, flat, 23.2)
    assert plane_found is not None
    assert np.abs(plane_found.at(points) - 1 / (1 / 7 + 2e-5 * points[:, 0])).max() < 0.01
    assert fit_plane(points, bent, 23.2) is None


def test_a_slant_is_fitted_only_if_it_is_significant():
    points = np.random.default_rng(5).uniform(0, 600, (400, 2))
    noise = np.random.default_rng(6).normal(0, 0.01, 400)
    slightly = 7 + 0.02 * (points[:, 0] / 300 - 1)
    slanted, level = fit_plane(points, slightly + noise, 23.2), fit_plane(points, 7 + noise, 23.2)
    assert slanted is not None and slanted.slanted
    assert np.abs(slanted.at(points) - slightly).max() < 0.005
    assert level is not None and not level.slanted
    facing = fit_plane(points, slightly + noise, 23.2, facing=True)
    assert facing is not None and not facing.slanted


def test_the_systematic_error_of_a_plane_grows_with_the_patch_size():
    rng = np.random.default_rng(1)
    points = rng.uniform(0, 1000, (200, 2))
    errors = []
    for ratio in (0.15, -0.6):
        found = fit_plane(points, 50.0 * ratio + 1e-4 * rng.standard_normal(200), 50.0)
        errors.append(found.standard_error(points).max())
    # The scatter of that many lenses alone would leave an error below a ten-thousandth of a pixel.
    assert 0.001 < errors[0] < 0.002
    assert 0.002 < errors[1] < 0.006
