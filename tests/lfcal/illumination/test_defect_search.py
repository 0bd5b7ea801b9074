"""Defective pixels of white images with known ones."""

from __future__ import annotations

import numpy as np

import lfcal


def test_hot_pixels_are_found_and_noise_is_not(calibrated_white):
    truth, camera = calibrated_white
    rng = np.random.default_rng(truth.seed + 1)
    rng.standard_normal(truth.size[::-1])
    rows, columns = rng.integers(0, truth.size[1], 40), rng.integers(0, truth.size[0], 40)
    hot = {(x, y) for x, y in zip(columns.tolist(), rows.tolist(), strict=True)}
    found = {(x, y) for x, y in camera.defects.pixels.tolist()}
    assert len(found & hot) >= 0.95 * len(hot)
    assert len(found - hot) <= 8


def test_dust_is_found_as_defects_of_its_own_pixels(drawn):
    truth = drawn("hexagonal", 20.3, 5.0, 26.0, size=(800, 600))
    image = truth.image()
    y, x = np.mgrid[: truth.size[1], : truth.size[0]]
    cx, cy = truth.centres(truth.index_of(np.array([[400.0, 300.0]])))[0] + (4, 2)
    specks = 1 - 0.6 * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * 4.0**2))
    camera = lfcal.calibrate((image * specks).astype(image.dtype), kind="white")
    found = camera.defects.pixels
    dust = specks < 0.99
    assert np.mean(~dust[found[:, 1], found[:, 0]] * (np.hypot(*(found - (cx, cy)).T) < 40)) < 0.01
    deep = np.zeros(dust.shape, bool)
    deep[found[:, 1], found[:, 0]] = True
    assert deep[(specks < 0.8) & (truth.light() > 0.5)].mean() > 0.9
