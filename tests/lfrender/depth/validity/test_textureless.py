"""Lenses of noise alone, and fine texture that passes for noise."""

from __future__ import annotations

import numpy as np

from lfcal import Lattice
from lfrender.depth.presets import PRESETS
from lfrender.depth.validity.textureless import find_textureless
from lfrender.flat.gray_flat import GrayFlat
from lfrender.flat.texture import sample_statistics

PITCH = 20
COLUMNS, ROWS = 20, 15
SIZE = (PITCH * COLUMNS, PITCH * ROWS)
# A patch size that divides the pitch: pixels of neighbours show the same places.
SHIFT = 4
NOISE = 0.006


def draw(heights):
    """A flat of noise with white noise of a scene of so many `heights` (columns,), and its lattice."""
    rng = np.random.default_rng(4)
    lattice = Lattice([10, 10], [[PITCH, 0], [0, PITCH]], SIZE, 9.5)
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    cx = x // PITCH * PITCH + 10
    cy = y // PITCH * PITCH + 10
    u = cx - (x - cx) * PITCH // SHIFT
    v = cy - (y - cy) * PITCH // SHIFT
    scene = rng.normal(0, 1, (SIZE[1] + 120, SIZE[0] + 120))[v + 60, u + 60]
    image = 0.5 + np.asarray(heights)[x // PITCH] * scene + rng.normal(0, NOISE, x.shape)
    centres = lattice.centres().astype(np.float32)
    return GrayFlat(image.astype(np.float32), centres, 8.5, PITCH), lattice


def search(gray, lattice, asked=None):
    plain = sample_statistics(gray)
    return find_textureless(gray, lattice, plain, PRESETS["balanced"], asked=asked)


def test_lenses_of_noise_beside_lenses_of_texture_are_textureless():
    textured = np.arange(COLUMNS) >= 12
    gray, lattice = draw(np.where(textured, 0.2, 0.0))
    blank = search(gray, lattice)
    column = np.rint(lattice.centres()[:, 0] / PITCH - 0.5).astype(int)
    assert blank[column < 12].mean() > 0.9
    assert not blank[column >= 12].any()


def test_texture_as_weak_as_noise_is_found_by_a_sample_of_matches():
    gray, lattice = draw(np.full(COLUMNS, 2 * NOISE))
    assert search(gray, lattice) is None


def test_nothing_is_matched_if_no_asked_lens_is_blank():
    gray, lattice = draw(np.full(COLUMNS, 2 * NOISE))
    nobody = np.zeros(len(gray.centres), bool)
    assert search(gray, lattice, asked=nobody) is not None
