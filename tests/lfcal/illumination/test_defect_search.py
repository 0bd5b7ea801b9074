"""Defective pixels of white images with known ones."""

from __future__ import annotations

import numpy as np

import lfcal
from lfcal.illumination.defect_search import are_rims


def test_hot_pixels_are_found_and_noise_is_not(calibrated_white):
    truth, camera = calibrated_white
    rng = np.random.default_rng(truth.seed + 1)
    rng.standard_normal(truth.size[::-1])
    rows = rng.integers(0, truth.size[1], 40)
    columns = rng.integers(0, truth.size[0], 40)
    hot = {(x, y) for x, y in zip(columns.tolist(), rows.tolist(), strict=True)}
    found = {(x, y) for x, y in camera.defects.pixels.tolist()}
    assert len(found & hot) >= 0.95 * len(hot)
    assert len(found - hot) <= 12


def test_dust_is_found_as_defects_of_its_own_pixels(drawn):
    truth = drawn("hexagonal", 20.3, 5.0, 26.0, size=(420, 320))
    image = truth.image()
    y, x = np.mgrid[: truth.size[1], : truth.size[0]]
    cx, cy = truth.centres(truth.index_of(np.array([[210.0, 160.0]])))[0] + (4, 2)
    specks = 1 - 0.6 * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * 4.0**2))
    camera = lfcal.calibrate((image * specks).astype(image.dtype), kind="white")
    found = camera.defects.pixels
    dust = specks < 0.99
    assert np.mean(~dust[found[:, 1], found[:, 0]] * (np.hypot(*(found - (cx, cy)).T) < 40)) < 0.01
    deep = np.zeros(dust.shape, bool)
    deep[found[:, 1], found[:, 0]] = True
    assert deep[(specks < 0.8) & (truth.light() > 0.5)].mean() > 0.9


def test_glare_at_the_border_is_no_defect(drawn):
    truth = drawn("hexagonal", 20.3, 5.0, 30.0, size=(420, 320), hot=0)
    image = truth.image()
    y, x = np.mgrid[: truth.size[1], : truth.size[0]]
    glare = 1 + 0.25 * np.exp(-np.hypot(x, y - 60) / 8)
    camera = lfcal.calibrate((image * glare).astype(image.dtype), kind="white")
    assert len(camera.defects.pixels) <= 5


def soft_cut_white(size=(660, 520), pitch=15.8, blur=1.8, cut=0.3, noise=0.01, seed=3):
    """A white image whose microimages are products of two soft discs, the second displaced toward
    the middle.
    """
    rng, (width, height) = np.random.default_rng(seed), size
    y, x = np.mgrid[:height, :width].astype(float)
    middle = np.array([width - 1, height - 1]) / 2
    reach = np.hypot(width, height) / 2
    basis = pitch * np.array([[1, 0], [0.5, np.sqrt(0.75)]])
    index = np.floor(np.stack([x - 3.3, y - 5.1], -1) @ np.linalg.inv(basis))
    corners = [(index + step) @ basis + (3.3, 5.1) for step in ((0, 0), (1, 0), (0, 1), (1, 1))]
    nearest = np.argmin([(c[..., 0] - x) ** 2 + (c[..., 1] - y) ** 2 for c in corners], axis=0)
    centre = np.take_along_axis(np.stack(corners), nearest[None, ..., None], 0)[0]
    radius = 0.46 * pitch
    light = np.ones((height, width))
    for size_of, shift in ((1.0, 0.0), (1.05, cut * radius / reach)):
        place = centre - shift * (centre - middle)
        light *= 1 / (
            1
            + np.exp(
                (np.hypot(x - place[..., 0], y - place[..., 1]) - size_of * radius) * 1.7 / blur
            )
        )
    light = 0.02 + 0.98 * light
    return np.rint(
        np.clip(
            light * 220 + 220 * noise * np.sqrt(light) * rng.standard_normal(light.shape), 0, 255
        )
    )


def test_what_the_gain_map_lacks_is_no_defect():
    camera = lfcal.calibrate(soft_cut_white().astype(np.uint8), kind="white")
    assert len(camera.defects.pixels) < 2e-4 * 660 * 520


def test_dust_over_several_lenses_is_found():
    white = soft_cut_white()
    y, x = np.mgrid[: white.shape[0], : white.shape[1]]
    dust = 1 - 0.6 * np.exp(-((x - 420) ** 2 + (y - 300) ** 2) / (2 * 20.0**2))
    camera = lfcal.calibrate(np.rint(white * dust).astype(np.uint8), kind="white")
    found = np.zeros(white.shape, bool)
    found[camera.defects.pixels[:, 1], camera.defects.pixels[:, 0]] = True
    assert found[(dust < 0.6) & (white > 100)].mean() > 0.9
    assert found[dust > 0.995].mean() < 2.5e-4


def test_white_images_of_others_have_no_false_defects(shared):
    image = lfcal.read_flat(shared("kinds", "types3.png"))
    camera = lfcal.calibrate(image, kind="white")
    assert len(camera.defects.pixels) < 1e-4 * image.shape[0] * image.shape[1]


def test_noise_cut_off_at_black_is_no_defect():
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:500, :600]
    far = np.hypot((x - 9) % 30 - 15, (y - 6) % 30 - 15)
    light = 220 * np.clip(13.5 - far, 0, 1)
    found = lfcal.calibrate(np.clip(rng.normal(light, 2.0), 0, 255).round().astype(np.uint8))
    assert found.confidence > 0.95 and found.warnings == ()
    assert len(found.defects.pixels) < 0.0002 * x.size


def test_rims_drawn_with_few_rays_a_pixel_are_no_defects():
    """Rims have values by chance, whose noise is neither even nor symmetric."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:500, :600]
    rays = 48
    light = np.zeros(x.shape)
    for _ in range(rays):
        u = x + rng.uniform(-0.5, 0.5, x.shape)
        v = y + rng.uniform(-0.5, 0.5, x.shape)
        for shift in (0, 0.5):
            across = (u - 9.3 + 23.2 * shift) % 23.2 - 11.6
            down = (v - 6.1 + 40.2 * shift) % 40.2 - 20.1
            light += (np.hypot(across, down) < 11.3) / rays
    encoded = np.where(light < 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    white = np.rint(200 * encoded).astype(np.uint8)
    assert len(lfcal.calibrate(white, kind="white").defects.pixels) <= 1
    hot = rng.integers(0, white.size, 100)
    white.ravel()[hot] = 255
    found = lfcal.calibrate(white, kind="white").defects.pixels
    seen = np.isin(found[:, 1] * white.shape[1] + found[:, 0], hot)
    assert seen.sum() >= 0.9 * len(np.unique(hot)) and (~seen).sum() <= 2


def test_defects_at_one_distance_from_many_centres_are_rims():
    rng = np.random.default_rng(4)
    lattice = lfcal.Lattice([9.0, 6.0], [[20.4, 0], [0, 20.4]], (700, 600), 3.0)
    angle = rng.uniform(0, 2 * np.pi, 60)
    rims = lattice.centres()[rng.permutation(len(lattice))[:60]]
    rims = rims + 2.3 * np.stack([np.cos(angle), np.sin(angle)], -1)
    bad = np.zeros((600, 700), bool)
    anywhere = rng.integers(0, (700, 600), (80, 2))
    # One speck of dust on a rim.
    x, y = lattice.centres()[500].astype(int)
    dust = np.stack(np.mgrid[x + 5 : x + 9, y + 5 : y + 9], -1).reshape(-1, 2)
    for places in (anywhere, dust):
        bad[tuple(places.T[::-1])] = True
    assert not are_rims(bad, np.ones_like(bad), lattice).any()
    column, row = np.rint(rims).astype(int).clip(0, (699, 599)).T
    bad[row, column] = True
    bad[bad] = ~are_rims(bad, np.ones_like(bad), lattice)
    assert bad[row, column].mean() < 0.05
    assert bad[tuple(anywhere.T[::-1])].mean() > 0.9 and bad[tuple(dust.T[::-1])].all()


def test_specks_of_dust_are_no_rims():
    lattice = lfcal.Lattice((10.0, 10.0), ((20.0, 0.0), (0.0, 20.0)), (400, 400), 9.0)
    bad = np.zeros((400, 400), bool)
    rng = np.random.default_rng(0)
    for x, y in lattice.points(rng.integers(0, 20, (60, 2))):
        bad[int(y) - 5 : int(y) + 6, int(x) - 5 : int(x) + 6] = True
    assert not are_rims(bad, np.ones(bad.shape, bool), lattice)[:].any()
