"""Output pixels larger than those of the flat are means of samples over their area."""

from __future__ import annotations

import numpy as np
import pytest

from lfrender.data.surface import Surface, edge_step
from lfrender.rendering.blend.blend_pixels import count_samples
from lfrender.rendering.blend.records import Grid

PITCH = 20.0
SPACING = 5.0  # [px of the scene] of the picture


@pytest.mark.parametrize(("patch_size", "error"), [(-5.0, 0.17), (-10.0, 0.1)])
@pytest.mark.parametrize("share", [0.2, 0.3, 0.45])
def test_a_pixel_on_an_outline_counts_each_surface_by_its_area(share, patch_size, error):
    # The pixel reaches from 37.5 to 42.5 px; the nearer surface lies to the left of the outline.
    outline = 37.5 + share * SPACING
    x = np.arange(0, 80, 0.25)
    sizes = np.where(x < outline - 0.125, -2.5, patch_size).astype(np.float32)
    surface = Surface(np.tile(sizes, (320, 1)), (0.0, 0.0), 0.25)
    grid = Grid((0.0, 0.0), SPACING, np.float32(PITCH / SPACING), (0, 0), None)
    centre = 40.0
    samples, apart = count_samples(
        surface.patch_size,
        surface.grid(edge_step(PITCH)),
        centre,
        centre,
        np.float32(patch_size),
        grid,
        np.float32(PITCH),
        np.zeros(41, np.float32),
    )
    places = centre + (np.arange(samples) - (samples - 1) / 2) * apart
    seen = (surface.at(np.stack([places, np.full(samples, centre)], 1)) == np.float32(-2.5)).mean()
    assert seen == pytest.approx(share, abs=error)


def test_a_pixel_within_a_surface_is_averaged_over_what_is_left_of_its_area():
    surface = Surface(np.full((80, 80), -10.0, np.float32), (0.0, 0.0), 1.0)
    grid = Grid((0.0, 0.0), SPACING, np.float32(PITCH / SPACING), (0, 0), None)
    squares = np.full(41, 3.0, np.float32)
    samples, apart = count_samples(
        surface.patch_size,
        surface.grid(edge_step(PITCH)),
        40.0,
        40.0,
        np.float32(-10.0),
        grid,
        np.float32(PITCH),
        squares,
    )
    # 2.5 px of the flat lie along the pixel.
    on_flat = apart * 2.5 / SPACING
    assert (samples**2 - 1) * on_flat**2 == pytest.approx(3.0, rel=1e-4)
