"""Gain maps estimated from white images of known light."""

from __future__ import annotations

import numpy as np

import lfcal
from lfcal.gain.gain_map import field_monomials
from lfcal.illumination.estimate import estimate_gain
from lfcal.lattice.lattice import Lattice

LATTICE = Lattice([12.3, 9.1], [[20.37, 0.41], [-0.41, 20.37]], (640, 480), 8.0)


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


def draw_rims(third: float, field: float) -> np.ndarray:
    """Root of the light of discs whose rim has a third harmonic [px] that changes over the field."""
    y, x = np.mgrid[: LATTICE.image_size[1], : LATTICE.image_size[0]]
    points = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    centres = LATTICE.points(np.rint(LATTICE.to_index(points)))
    dx, dy = (points - centres).T
    across = LATTICE.field_place(centres)[:, 0]
    rim = 8 + (third + field * across) * np.cos(3 * np.arctan2(dy, dx))
    light = np.clip((rim - np.hypot(dx, dy)) / 2 + 0.5, 0, 1)
    noise = np.random.default_rng(3).normal(0, 0.02, light.shape)
    return np.sqrt(np.maximum(0.8 * light + noise, 0)).reshape(x.shape).astype(np.float32)


def test_rim_has_the_harmonic_that_its_pixels_show_and_no_other():
    gain = estimate_gain(draw_rims(0.3, -0.2), LATTICE, scene=False)
    # Discs of 8 px, but the rim is that at the radius of the map.
    rim = gain.rim * 8 / gain.radius
    np.testing.assert_allclose(rim[5, :2], [0.3, -0.2], atol=0.02)
    rest = rim.copy()
    rest[5, :2] = 0
    assert np.abs(rest).max() < 0.06


def test_round_rims_have_no_harmonics_that_matter():
    rim = estimate_gain(draw_rims(0, 0), LATTICE, scene=False).rim
    assert np.abs(rim).max() < 0.01 and np.count_nonzero(rim) < 20
