"""White images of cells with straight edges that are not square."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
from lfcal.detection.search import find_candidates
from lfcal.images.preprocessing import sqrt_luminance
from lfcal.white_fit.fit import fit_lattice_to_white_image
from tests.lfcal._whites import HEXAGON, turned


def _draw_hexagons(pitch: float, gap: float, degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """A white image of hexagons, with 64 places in each pixel, and its true centres."""
    rng = np.random.default_rng(11)
    size = (700, 560)
    basis = turned(HEXAGON, pitch, degrees)
    normals = turned(np.vstack([HEXAGON, HEXAGON[1] - HEXAGON[0]]), 1.0, degrees)
    origin = np.array(size) / 2 + rng.uniform(0, pitch, 2)
    y, x = np.mgrid[: size[1], : size[0]]
    light = np.zeros(x.shape)
    for part in range(64):
        across = x + (part % 8 + 0.5) / 8 - 0.5 - origin[0]
        down = y + (part // 8 + 0.5) / 8 - 0.5 - origin[1]
        place = np.stack([across, down], -1)
        whole = np.floor(place @ np.linalg.inv(basis))
        far = np.full(x.shape, np.inf)
        for corner in ((0, 0), (0, 1), (1, 0), (1, 1)):
            from_centre = place - (whole + corner) @ basis
            far = np.minimum(far, np.abs(from_centre @ normals.T).max(-1))
        light += (far < (pitch - gap) / 2) / 64
    middle = np.array(size) / 2
    square = ((x - middle[0]) ** 2 + (y - middle[1]) ** 2) / (middle**2).sum()
    light = (0.02 + 0.98 * light) * (1 - 0.3 * square)
    light += 0.01 * np.sqrt(light) * rng.standard_normal(light.shape)
    index = np.stack(np.meshgrid(np.arange(-40, 41), np.arange(-40, 41)), -1).reshape(-1, 2)
    centres = origin + index @ basis
    inside = ((centres > pitch) & (centres < np.array(size) - pitch)).all(1)
    return np.rint(np.clip(200 * light, 0, 255)).astype(np.uint8), centres[inside]


def _error(lattice: lfcal.Lattice, centres: np.ndarray) -> float:
    offset = lattice.points(np.rint(lattice.to_index(centres))) - centres
    return float(np.sqrt((offset**2).sum(1).mean()))


@pytest.mark.parametrize(("pitch", "degrees"), [(46.0, 14), (36.3, 5), (53.4, 21)])
def test_fit_of_hexagonal_cells_is_nearer_to_the_truth_than_its_start(pitch, degrees):
    white, centres = _draw_hexagons(pitch, 1.8, degrees)
    picture = sqrt_luminance(white)
    start = find_candidates(picture)[0]
    fit = fit_lattice_to_white_image(picture, start)
    assert _error(fit.lattice, centres) < min(_error(start.lattice, centres), 0.005)
    assert fit.residual_rms < 0.015
