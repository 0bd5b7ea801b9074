"""White images of square cells with straight edges and dark gaps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

import lfcal


def _draw(
    pitch: float, gap: float, degrees: float, sigma: float = 1e-9
) -> tuple[np.ndarray, np.ndarray]:
    """A white image with one random place in each of 36 parts of a pixel, and its true centres.

    A Gaussian of standard deviation `sigma` [px] blurs the edges.
    """
    rng = np.random.default_rng(5)
    size = (560, 440)
    angle = np.radians(degrees)
    basis = pitch * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    origin = np.array(size) / 2 + rng.uniform(0, pitch, 2)
    y, x = np.mgrid[: size[1], : size[0]]
    light = np.zeros(x.shape)
    for part in range(36):
        across = x + (part % 6 + rng.random(x.shape)) / 6 - 0.5 - origin[0]
        down = y + (part // 6 + rng.random(x.shape)) / 6 - 0.5 - origin[1]
        cells = np.stack([across, down], -1) @ np.linalg.inv(basis)
        far = np.abs(cells - np.rint(cells)) * pitch
        # The light of the neighbours reaches into the gap.
        depth = (pitch - gap) / 2 - np.stack([far, pitch - far])
        light += ndtr(depth / sigma).sum(0).prod(-1) / 36
    light = 0.02 + 0.98 * light
    light += 0.01 * np.sqrt(light) * rng.standard_normal(light.shape)
    index = np.stack(np.meshgrid(np.arange(-40, 41), np.arange(-40, 41)), -1).reshape(-1, 2)
    centres = origin + index @ basis
    inside = ((centres > pitch) & (centres < np.array(size) - pitch)).all(1)
    return np.rint(np.clip(220 * light, 0, 255)).astype(np.uint8), centres[inside]


@pytest.mark.parametrize(
    ("pitch", "gap", "degrees"),
    [(35, 1, 0), (50, 1, 0), (35.3, 1, 0), (35.3, 1, 7), (50.1, 3, 20), (20.4, 2, 45)],
)
def test_centres_of_square_cells_are_right_to_two_thousandths_of_a_pixel(pitch, gap, degrees):
    white, centres = _draw(pitch, gap, degrees)
    camera = lfcal.calibrate(white, kind="white")
    lattice = camera.lattice
    offset = lattice.points(np.rint(lattice.to_index(centres))) - centres
    assert np.sqrt((offset**2).sum(1).mean()) < 0.002
    assert camera.residual_rms < 0.02


@pytest.mark.parametrize(("pitch", "gap"), [(35, 1), (35, 3), (35.3, 2)])
def test_centres_of_cells_with_gaussian_edges_are_right_to_two_thousandths_of_a_pixel(pitch, gap):
    white, centres = _draw(pitch, gap, 0, 0.7)
    lattice = lfcal.calibrate(white, kind="white").lattice
    offset = lattice.points(np.rint(lattice.to_index(centres))) - centres
    assert np.sqrt((offset**2).sum(1).mean()) < 0.002
