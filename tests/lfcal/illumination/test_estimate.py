"""Gain maps estimated from white images of known light."""

from __future__ import annotations

import numpy as np

import lfcal
from lfcal.gain.gain_map import field_monomials
from lfcal.lattice.lattice import Lattice


def inside_discs(truth, camera, margin):
    """Pixels of whole uncut discs, at least `margin` px off the rim."""
    y, x = np.mgrid[: truth.size[1], : truth.size[0]]
    points = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    far = np.hypot(*(points - truth.centres(truth.index_of(points))).T)
    return (far < truth.fill * truth.pitch / 2 - margin).reshape(x.shape) & np.isfinite(
        camera.gain()
    )


def test_gain_is_the_light_to_half_a_percent(calibrated_white):
    truth, camera = calibrated_white
    inside = inside_discs(truth, camera, 1.5)
    ratio = camera.gain()[inside] / truth.light()[inside]
    assert inside.mean() > 0.55
    assert (ratio / ratio.mean()).std() < 0.005
    assert 0.95 < np.nanmax(camera.gain()) < 1.05


def test_gain_of_cut_microimages_follows_the_cut(drawn):
    truth = drawn("hexagonal", 20.3, 5.0, 26.0, strength=0.3, size=(800, 600))
    camera = lfcal.calibrate(truth.image(), kind="white")
    light = truth.light()
    gain = camera.gain()
    lit = np.isfinite(gain) & (light > 0.5)
    ratio = gain[lit] / light[lit]
    assert (np.abs(ratio / np.median(ratio) - 1) < 0.05).mean() > 0.97
    assert np.isnan(gain[light < 0.1]).mean() > 0.99
    usable = camera.usable_radius()
    middle = np.hypot(*(camera.lattice.centres() - truth.middle).T) < 0.2 * truth.reach
    corner = np.hypot(*(camera.lattice.centres() - truth.middle).T) > 0.9 * truth.reach
    assert usable[corner].mean() < 0.85 * usable[middle].mean()


def test_field_monomials_are_powers_of_the_place():
    lattice = Lattice([3.0, 2.0], [[9.0, 0.0], [0.0, 9.0]], (301, 201), 4.0)
    points = np.random.default_rng(1).uniform(0, 200, (50, 2))
    x, y = ((points - [150, 100]) / (np.hypot(301, 201) / 2)).T
    wanted = np.column_stack([x ** (d - b) * y**b for d in range(5) for b in range(d + 1)])
    np.testing.assert_allclose(field_monomials(lattice.field_place(points), 15), wanted, atol=1e-12)
