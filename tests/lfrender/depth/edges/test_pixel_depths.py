"""Pixels of microimages take the depth of the surface that they show."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Lattice
from lfrender.depth.edges.candidates import mark_levels
from lfrender.depth.edges.pixel_depths import measure_pixel_depths
from lfrender.depth.surface.scene_grid import PointGrid, lens_array

PITCH = 20.0
SHAPE = (160, 200)
LENSES = lens_array(
    Lattice([9.5, 9.5], [[PITCH, 0], [0, PITCH]], SHAPE[::-1], 9.5), 0.04 * PITCH, 8.5
)
NEAR = -5.0
FAR = -9.0
MIDDLE = 99.0  # [px]
SPACING = PITCH / 7
GRID = PointGrid(-0.5, SPACING)
# Samples of a pixel each way.
FINE = 6


def _is_card(x, y):
    """Whether the near surface reaches to a place of the scene; its edge is oblique."""
    return x - 0.3 * y > 75


def _texture(x, y, rng):
    waves = rng.uniform(-0.25, 0.25, (12, 2))
    phases = rng.uniform(0, 2 * np.pi, 12)
    return sum(
        np.sin(u * x + v * y + phase) for (u, v), phase in zip(waves, phases, strict=True)
    ) / np.sqrt(len(waves))


@pytest.fixture(scope="module")
def scene():
    """The flat of a dark card before a bright wall, and the share of each pixel that shows the
    card.
    """
    height, width = SHAPE
    steps = (np.arange(FINE) + 0.5) / FINE - 0.5
    y = (np.arange(height)[:, None] + steps).reshape(-1, 1)
    x = (np.arange(width)[:, None] + steps).reshape(1, -1)
    centre_x = PITCH * np.floor((x + 0.5) / PITCH) + 9.5
    centre_y = PITCH * np.floor((y + 0.5) / PITCH) + 9.5

    def point(size):
        return (centre_x - (x - centre_x) * PITCH / size, centre_y - (y - centre_y) * PITCH / size)

    card_x, card_y = point(NEAR)
    wall_x, wall_y = point(FAR)
    is_card = _is_card(card_x, card_y)
    card = 0.2 + 0.06 * _texture(card_x, card_y, np.random.default_rng(1))
    wall = 0.7 + 0.09 * _texture(wall_x, wall_y, np.random.default_rng(2))

    def average(values):
        return values.reshape(height, FINE, width, FINE).mean((1, 3))

    light = average(np.where(is_card, card, wall)).astype(np.float32)
    grid_x = GRID.first + SPACING * np.arange(71)
    grid_y = GRID.first + SPACING * np.arange(57)[:, None]
    surface = np.where(_is_card(grid_x, grid_y), NEAR, FAR).astype(np.float32)
    return light, average(is_card * 1.0), surface


def _measure(light, surface, grid=GRID, wanted=None):
    levels = mark_levels(surface, PITCH, 10)
    if wanted is None:
        wanted = np.ones(len(LENSES.centres), bool)
    rounds = [np.zeros((1, 1), np.float32)]
    for _ in range(2):
        out = np.full(light.shape, np.nan, np.float32)
        moved = np.zeros(len(wanted), np.float32)
        measure_pixel_depths(
            light,
            LENSES,
            surface,
            grid,
            levels,
            wanted,
            rounds[-1],
            np.float32(1e-5),
            0.1 * PITCH,
            out,
            moved,
        )
        rounds.append(out)
    return rounds[-1]


def test_pixels_inside_either_surface_have_its_depth(scene):
    light, share, surface = scene
    found = _measure(light, surface)
    known = np.isfinite(found)
    assert (np.abs(found - NEAR) < 0.4)[known & (share == 1)].mean() > 0.99
    assert (np.abs(found - FAR) < 0.4)[known & (share == 0)].mean() > 0.96


def test_pixels_on_the_outline_are_behind_it_if_little_of_their_light_is_from_before(scene):
    light, share, surface = scene
    found = _measure(light, surface)
    known = np.isfinite(found)
    behind = known & (share > 0) & (share < 0.25)
    before = known & (share > 0.45) & (share < 1)
    assert behind.sum() > 20
    # By their mismatch alone 1 % of them are; the others lie beside pixels that are mixed as well.
    assert (np.abs(found - FAR) < 0.4)[behind].mean() > 0.45
    assert (np.abs(found - NEAR) < 0.4)[before].mean() > 0.99


def test_a_flat_turned_by_half_has_its_depths_turned(scene):
    light, _, surface = scene
    # The turned scene has its first grid value where the last one was.
    last_x = SHAPE[1] - 1 - (GRID.first + SPACING * (surface.shape[1] - 1))
    last_y = SHAPE[0] - 1 - (GRID.first + SPACING * (surface.shape[0] - 1))
    assert last_x == pytest.approx(last_y)
    turned = np.ascontiguousarray(surface[::-1, ::-1])
    found = _measure(np.ascontiguousarray(light[::-1, ::-1]), turned, PointGrid(last_x, SPACING))
    first = _measure(light, surface)
    both = np.isfinite(first) & np.isfinite(found[::-1, ::-1])
    assert (np.abs(first - found[::-1, ::-1]) < 0.4)[both].mean() > 0.99


def test_lenses_that_are_not_wanted_are_left_alone(scene):
    light, _, surface = scene
    wanted = LENSES.centres[:, 0] < MIDDLE
    found = _measure(light, surface, wanted=wanted)
    assert np.isnan(found[:, 101:]).all()
    assert np.isfinite(found[70:90, 70:90]).any()
