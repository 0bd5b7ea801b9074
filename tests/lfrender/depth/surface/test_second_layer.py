"""Depths of a thin rod before a wall, in a flat that is drawn by hand."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Lattice
from lfrender.depth.presets import PRESETS
from lfrender.depth.surface.second_layer import find_second_layer
from lfrender.flat.gray_flat import GrayFlat
from lfrender.flat.neighbours import neighbours_of
from lfrender.flat.texture import Texture, measure_statistics

PITCH = 50.0
WALL = 14.3
SIZE = (350, 350)
# The middle line of the rod [px of the scene] and half its width: 5 px in a microimage.
MIDDLE = 180.0
HALF = 10.0


def draw(rod, turn=0.0, half=HALF):
    """Grey flat of a wall and, at patch size `rod` [px], a rod of `half` a width before it; its lattice, and where
    lenses show the rod.
    """
    lattice = Lattice([25, 25], [[PITCH, 0], [0, PITCH]], SIZE, 24.0)
    centres = lattice.centres()
    y, x = np.mgrid[: 3 * SIZE[1], : 3 * SIZE[0]] / 3 - 1 / 3
    cx = 25 + PITCH * np.clip(np.rint((x - 25) / PITCH), 0, 6)
    cy = 25 + PITCH * np.clip(np.rint((y - 25) / PITCH), 0, 6)

    def place(s):
        return cx - (x - cx) * PITCH / s, cy - (y - cy) * PITCH / s

    u, v = place(WALL)
    wall = 0.5 + 0.12 * np.sin(u / 7 + 2 * np.sin(v / 31)) + 0.12 * np.sin(v / 8 + np.sin(u / 9))
    u, v = place(rod)
    # A rod that leans to one side has no depth that only one direction tells.
    across = u - MIDDLE - turn * (v - 175)
    light = 0.35 + 0.25 * np.sin(v / 9 + np.sin(v / 23)) + 0.1 * np.sin(v / 5)
    flat = np.where(np.abs(across) < half, light, wall)
    flat = flat.reshape(SIZE[1], 3, SIZE[0], 3).mean((1, 3))
    gray = GrayFlat(flat.astype(np.float32), centres.astype(np.float32), 23.0, PITCH)
    # A microimage shows half a pitch of PITCH / |s| either way.
    shown = 23.0 * PITCH / abs(rod)
    away = np.abs(centres[:, 0] - MIDDLE - turn * (centres[:, 1] - 175))
    return gray, lattice, away < shown - 2 * HALF, away > shown + 2 * HALF


def search(gray, lattice, correlation=0.5):
    neighbours = neighbours_of(lattice)
    textured = np.ones(len(gray.centres), bool)
    texture = Texture(gray, measure_statistics(gray), 1 / 255, textured, ~textured)
    sizes = np.full(len(textured), WALL, np.float32)
    correlation = np.full(len(textured), correlation, np.float32)
    return find_second_layer(texture, neighbours, sizes, correlation, PRESETS["balanced"])


@pytest.mark.parametrize("rod", [-11.4, -8.7])
def test_a_rod_a_tenth_of_a_pitch_wide_is_found_to_a_tenth_of_a_pixel(rod):
    gray, lattice, shown, hidden = draw(rod, turn=0.2)
    second = search(gray, lattice)
    found = np.isfinite(second) & shown
    assert found.sum() > 0.6 * shown.sum()
    error = np.abs(second - rod)[found]
    assert np.median(error) < 0.1, f"{np.median(error):.3f} px"
    assert np.quantile(error, 0.9) < 0.3
    assert np.isnan(second[hidden]).all()


def test_a_wall_without_a_rod_has_no_second_layer():
    gray, lattice, _, _ = draw(-11.4, half=0.0)
    assert np.isnan(search(gray, lattice)).all()


def test_lenses_that_correlate_well_are_not_searched():
    gray, lattice, _, _ = draw(-11.4, turn=0.2)
    assert np.isnan(search(gray, lattice, correlation=0.9)).all()


@pytest.mark.parametrize(("across", "down"), [(True, False), (False, True)], ids=["x", "y"])
def test_a_mirrored_flat_has_the_same_second_layers(across, down):
    gray, lattice, _, _ = draw(-11.4, turn=0.2)
    first = search(gray, lattice)
    image = np.ascontiguousarray(gray.image[:: -1 if down else 1, :: -1 if across else 1])
    turned = GrayFlat(image, gray.centres, gray.radius, PITCH)
    second = search(turned, lattice).reshape(7, 7)[:: -1 if down else 1, :: -1 if across else 1]
    both = np.isfinite(first) & np.isfinite(second.ravel())
    assert both.sum() > 0.7 * np.isfinite(first).sum()
    assert np.median(np.abs(first - second.ravel())[both]) < 0.1
