"""Lenses that see a ball are measured at their centres."""

import dataclasses
import functools

import numpy as np
import pytest

import lfrender
from data_synth import SCENES, Camera, Scene, Sphere, simulate
from lfrender.depth.presets import PRESETS
from lfrender.depth.refinement.lens_plane import LensFits
from lfrender.depth.refinement.quadratic_fit import fit_quadratic
from lfrender.flat.lens_graph import neighbour_rows

PITCH = 36.0


@functools.cache
def ball():
    """A ball of seven pitches across at `s / D = -0.25`, before a wall."""
    camera = Camera.design((600, 480), PITCH, "hex", rotation=4.0)
    wall, cards = SCENES["plane"](camera, ratio=-0.5), SCENES["clutter"](camera, seed=3)
    texture = next(surface.texture for surface in cards.surfaces if isinstance(surface, Sphere))
    depth = camera.depth_at(-0.25)
    middle, side = camera.place([(300, 240), (300 + 3.5 * PITCH, 240)], depth)
    scene = Scene("ball", (*wall.surfaces, Sphere(middle, side[0] - middle[0], texture)))
    return simulate(scene, camera, samples=64, seed=1, noise=(8000.0, 4.0))


def on_ball(truth):
    return (truth.mode != 0) & ~truth.mixed & (np.abs(truth.patch_size + 0.25 * PITCH) < 0.1 * PITCH)


def test_lenses_on_a_ball_are_measured_at_their_centres(monkeypatch):
    shot = ball()
    truth = shot.truth
    on_it = on_ball(truth)
    assert on_it.sum() >= 12
    error = {}
    for bends in (True, False):
        monkeypatch.setitem(PRESETS, "balanced", dataclasses.replace(PRESETS["balanced"], quadratic_fit=bends))
        depth = lfrender.analyze(shot.flat, truth.calibration)
        error[bends] = (depth.patch_size - truth.patch_size)[on_it]
    assert abs(np.median(error[True])) < 0.01
    assert np.median(np.abs(error[True])) < 0.6 * np.median(np.abs(error[False])), error


def fitted(gray, lattice, sizes):
    """`fit_quadratic` from these sizes, without slants."""
    n = len(sizes)
    fits = LensFits(
        sizes.astype(np.float32), np.full(n, 0.02, np.float32), np.zeros((n, 2), np.float32), np.ones(n, np.float32)
    )
    neighbours = neighbour_rows(lattice, lattice.steps)
    return fit_quadratic(gray, neighbours, fits, np.ones(n, np.float32), np.full(n, 0.1, np.float32))


@pytest.mark.parametrize("slant", [(0.0, 0.0), (0.04, -0.03)])
def test_lenses_return_to_their_plane_and_stay_there(drawn_flat, slant):
    gray, lattice, truth, inner = drawn_flat(-5.0, slant=slant, noise=0.005)
    fits, share = fitted(gray, lattice, truth + 0.2)
    assert np.median(share[inner]) > 0.8
    assert np.median(np.abs(fits.patch_size - truth)[inner]) < 0.03
    # The slant that is drawn is that of the middle lens, and grows with s.
    off = fits.slant - np.outer(truth / -5.0, slant)
    np.testing.assert_allclose(np.median(off[inner], axis=0), 0, atol=0.004)
    fits, _ = fitted(gray, lattice, truth)
    assert np.median(np.abs(fits.patch_size - truth)[inner]) < 0.01


def test_lenses_that_show_too_little_keep_their_first_fit(drawn_flat):
    gray, lattice, truth, _ = drawn_flat(-5.0)
    few = dataclasses.replace(gray, radius=3.0)
    fits, share = fitted(few, lattice, truth)
    assert not share.any()
    np.testing.assert_array_equal(fits.patch_size, truth.astype(np.float32))
