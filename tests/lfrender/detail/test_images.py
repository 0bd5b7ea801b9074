"""Images of the spectrum cancel over lenses whose pixels have different phases, and add up where they do not."""

from __future__ import annotations

import numpy as np
import pytest

from data_synth import Camera
from lfcal import LensBlur
from lfrender.detail.defocus import Defocus
from lfrender.detail.filters import make_filters
from lfrender.detail.images import image_power

PITCH, REACH = 24.0, 1.7


def calibration(**options):
    return Camera.design(size=(480, 400), pitch=PITCH, **options).calibration()


def mean_over_places(camera, ratio, multiple, places=9):
    """Power of the weighted mean of phases over the lenses that see a place, and its mean over places in a cell."""
    lattice = camera.lattice
    limit = min(lattice.radius / abs(ratio), REACH * lattice.pitch)
    centres = np.stack(np.meshgrid(np.arange(-6, 7), np.arange(-6, 7)), -1).reshape(-1, 2) @ lattice.basis
    at = (np.stack(np.meshgrid(*[np.arange(places)] * 2), -1).reshape(-1, 2) + 0.5) / places @ lattice.basis
    weight = np.maximum(1 - ((at[:, None] - centres) ** 2).sum(2) / limit**2, 0)
    phase = np.exp(2j * np.pi * (1 + ratio) * (centres @ multiple))
    return (np.abs((weight * phase).sum(1) / weight.sum(1)) ** 2).mean()


@pytest.mark.parametrize("options", [{"lattice": "square"}, {"rotation": 11.0}])
@pytest.mark.parametrize("ratio", [-0.25, -0.21, 0.33])
def test_power_of_images_is_that_of_the_mean_over_lenses(options, ratio):
    camera = calibration(**options)
    along, diagonal = image_power(camera, np.array([ratio]), REACH)[:, 0]
    told = [mean_over_places(camera, ratio, multiple) for multiple in ((1, 0), (0, 1), (1, 1), (1, -1))]
    assert along == pytest.approx(np.mean(told[:2]), abs=0.05)
    assert diagonal == pytest.approx(np.mean(told[2:]), abs=0.05)


def test_less_is_restored_where_the_pixels_of_all_lenses_have_one_phase():
    # A picture three times as fine as the flat, at a depth where 24 px are a whole number of steps of the scene.
    size, discs = -6.0, ((0.8,) * 33,)
    blur = LensBlur(5.0, 1.0, [0.0], [0.1], [size / PITCH], [[0.8]], [[0.2]])
    strongest = []
    for options in ({"lattice": "square"}, {"lattice": "square", "rotation": 11.0}):
        filters = make_filters(
            Defocus(blur, discs, 0.001), calibration(**options), -3 * size, REACH, 0.0, 3, (size, size)
        )
        strongest.append(filters.gains[-1, round(-size / PITCH * filters.per_ratio), :2].sum())
    assert strongest[0] < 0.5 * strongest[1]
