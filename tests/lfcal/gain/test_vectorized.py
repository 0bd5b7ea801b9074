"""Relative light of many pixels against that of single ones."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.gain.kernel import relative_light
from lfcal.gain.vectorized import make_edge_table, relative_light_general, relative_light_round


def test_light_of_many_pixels_equals_that_of_each():
    rng = np.random.default_rng(0)
    profile = np.exp(-((np.arange(40) / 25) ** 4))
    lens = np.concatenate([rng.normal(0, 0.01, 2), rng.normal(0, 1e-3, 3), [0.0, 0.0, 0.02]])
    pixels = rng.uniform(-8, 8, (3, 500)).astype(np.float32)
    shape, ring = np.empty(500, np.float32), np.empty(500, np.int32)
    base, rise = profile[:-1].astype(np.float32), np.diff(profile).astype(np.float32)
    relative_light_round(pixels, 500, lens, base, rise, np.float32((1 - lens[7]) / 0.25), shape, ring)
    cut = np.zeros(6)
    wanted = [relative_light(float(x), float(y), lens, profile, 0.25, cut)[0] for x, y in pixels[:2].T]
    np.testing.assert_allclose(shape, wanted, atol=2e-5)


@pytest.mark.parametrize("rim", [1, 3, 7])
@pytest.mark.parametrize("soft", [0.0, 0.4])
def test_light_of_many_pixels_of_a_cut_lens_equals_that_of_each(rim, soft):
    rng = np.random.default_rng(0)
    profile = np.exp(-((np.arange(40) / 25) ** 4))
    lens = np.concatenate([rng.normal(0, 0.01, 2), rng.normal(0, 1e-3, 3), [0.4, -0.8], rng.normal(0, 0.03, rim)])
    cut = np.array([0.1, 0.2, 1.0, 5.0, soft, 0.03])
    pixels = rng.uniform(-8, 8, (3, 500)).astype(np.float32)
    shape, ring, spare = np.empty(500, np.float32), np.empty(500, np.int32), np.empty((5, 500), np.float32)
    base, rise = profile[:-1].astype(np.float32), np.diff(profile).astype(np.float32)
    relative_light_general(pixels, 500, lens, base, rise, 0.25, cut, make_edge_table(), spare, shape, ring)
    wanted = np.array([relative_light(float(x), float(y), lens, profile, 0.25, cut)[:2] for x, y in pixels[:2].T])
    np.testing.assert_allclose(shape, wanted[:, 0], atol=5e-5)
    np.testing.assert_allclose(ring, np.minimum(wanted[:, 1] / 0.25, 38.5), atol=1.001)
