"""Patterns whose cells look like microimages but show no parallax are refused."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from skimage import data

import lfcal
from data_synth import SCENES, Camera, simulate
from lfcal.detection.parallax_test import check_parallax, compare_neighbours, shows_scene
from lfcal.images.preprocessing import sqrt_luminance

_SIZE = (480, 360)


def _place(patterns, degrees):
    u, v = patterns.rotate(degrees, _SIZE)
    return u + 9.3, v + 400.7


def _hexagons(patterns, pitch, degrees):
    """Distance to the nearest centre, how much farther the next one is [px], and a random number of each cell."""
    basis = pitch * np.array([[1.0, 0.0], [0.5, 0.75**0.5]])
    place = np.stack(_place(patterns, degrees), -1)
    nearest = np.rint(place @ np.linalg.inv(basis))
    index = np.array([nearest + np.array([i, j]) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    far = np.hypot(*np.moveaxis(place - index @ basis, -1, 0))
    own = np.take_along_axis(index, far.argmin(0)[None, ..., None], 0)[0].astype(int)
    far = np.sort(far, axis=0)
    return far[0], far[1] - far[0], np.random.default_rng(3).normal(0, 1, (211, 211))[own[..., 0] % 211, own[..., 1]]


def test_honeycomb_of_cells_of_different_tones_is_refused(patterns, pitch=26.7):
    _, edge, own = _hexagons(patterns, pitch, 20)
    with pytest.raises(lfcal.CalibrationError, match="tiles"):
        lfcal.calibrate(patterns.photograph(np.where(edge < 0.1 * pitch, 40, 140 + 18 * own)))


def test_sheet_with_dark_holes_is_refused(patterns, pitch=10.2):
    far, _, _ = _hexagons(patterns, pitch, 7)
    with pytest.raises(lfcal.CalibrationError):
        lfcal.calibrate(patterns.photograph(np.where(far < 0.32 * pitch, 30.0, 180.0)))


@pytest.mark.parametrize(("pitch", "wire"), [(16.2, 20.0), (33.3, 220.0)])
def test_photograph_behind_a_mesh_is_refused(patterns, pitch, wire):
    u, v = _place(patterns, 8)
    scene = cv2.resize(cv2.cvtColor(data.coffee(), cv2.COLOR_RGB2GRAY), _SIZE).astype(float)
    mesh = (u % pitch < 0.18 * pitch) | (v % pitch < 0.18 * pitch)
    with pytest.raises(lfcal.CalibrationError):
        lfcal.calibrate(patterns.photograph(np.where(mesh, wire, scene)))


def test_cells_with_independent_content_are_refused(patterns):
    u, v = _place(patterns, 9)
    pitch = 22.3
    inside = [np.floor((w % pitch) / pitch * 7 - 1).astype(int) for w in (u, v)]
    number = np.floor(u / pitch).astype(int) * 7 + np.floor(v / pitch).astype(int) * 13
    sign = np.random.default_rng(2).integers(0, 2, (61, 7, 7))[number % 61, inside[0], inside[1]]
    key = np.where((np.minimum(*inside) >= 0) & (np.maximum(*inside) < 5), sign, 0)
    gap = (u % pitch < 0.2 * pitch) | (v % pitch < 0.2 * pitch)
    with pytest.raises(lfcal.CalibrationError, match="shifted"):
        lfcal.calibrate(patterns.photograph(np.where(gap, 20.0, 120.0 + 90 * key)))


def test_neighbours_in_a_scene_match_when_shifted_by_the_disparity(house):
    found = compare_neighbours(sqrt_luminance(house.flat), house.camera.lattice)
    assert min(found.unshifted, found.distant) > 1.6 * found.matched
    assert found.tone_spread < 0.6 * found.texture


def test_noisy_scene_is_not_taken_for_a_pattern(house, decibels=18):
    flat = house.flat.astype(float)
    noise = np.sqrt((flat**2).mean()) * 10 ** (-decibels / 20) * np.random.default_rng(1).standard_normal(flat.shape)
    check_parallax(sqrt_luminance(np.maximum(flat + noise, 0)), house.camera.lattice, white=False)


def test_white_image_with_lens_types_and_uneven_light_is_not_taken_for_a_pattern(whites):
    basis = whites.turned(whites.HEXAGON, 18.3, 11)
    image, origin = whites.white_image(basis, (600, 450), noise=0.0)
    y, x = np.mgrid[:450, :600]
    index = np.rint((np.stack([x, y], -1) - origin) @ np.linalg.inv(basis))
    kind = ((index[..., 0] - index[..., 1]) % 3).astype(int)
    light = image * np.array([1.0, 0.9, 0.8])[kind] * (0.05 + 0.95 / (1 + np.exp((x - 300) / 30)))
    light += 0.05 * light.max() * np.random.default_rng(4).standard_normal(light.shape)
    lattice = lfcal.Lattice(origin, basis, (600, 450), 8.0)
    assert compare_neighbours(sqrt_luminance(np.maximum(light, 0)), lattice).tone_spread < 0.03
    check_parallax(sqrt_luminance(np.maximum(light, 0)), lattice, white=True)


def test_scene_that_is_nearly_even_within_its_microimages_is_no_white_image(pitch=20.0, ratio=0.35, contrast=0.4):
    camera = Camera.design((int(pitch * 31), int(pitch * 23)), pitch, "square", -13.0)
    shot = simulate(SCENES["plane"](camera, ratio=ratio, seed=21), camera, samples=5, noise=(10000, 4))
    faint = contrast * shot.flat + (1 - contrast) * 0.6 * shot.white[..., None].astype(float)
    found = lfcal.calibrate(faint.round().astype(np.uint8))
    assert found.source == "scene"
    assert found.confidence > 0.9
    assert lfcal.calibrate(shot.white).source == "white"


@pytest.mark.parametrize("outlines", [0.0, 0.15])
def test_lenses_that_show_the_same_unmoved_are_those_of_an_unfocused_camera(outlines):
    size, pitch = (640, 520), 21.7
    rng = np.random.default_rng(8)
    lattice = lfcal.Lattice([310.2, 250.7], [[pitch, 0.3], [-0.3, pitch]], size, 9.5)
    y, x = np.mgrid[: size[1], : size[0]]
    place = np.stack([x, y], -1).astype(float)
    index = np.rint(lattice.to_index(place.reshape(-1, 2)))
    delta = (place.reshape(-1, 2) - lattice.points(index)) / pitch
    # Light from the directions of a lens, which changes slowly from lens to lens; sharp where objects end.
    own = rng.standard_normal((64, 64, 2)) if outlines else np.zeros((64, 64, 2))
    own[rng.random((64, 64)) > outlines] = 0
    i, j = index.astype(int).T % 64
    slope = np.stack([np.cos(index[:, 0] / 9), np.sin(index[:, 1] / 8)], -1) + 2 * own[i, j]
    light = 1 + 0.12 * (slope * np.sin(4 * delta)).sum(1) + 0.005 * rng.standard_normal(len(delta))
    picture = light.reshape(size[::-1]).astype(np.float32)
    found = compare_neighbours(picture, lattice)
    assert found.typical_across > 1.8 * found.typical_unshifted
    assert not check_parallax(picture, lattice, white=False)
    assert shows_scene(picture, lattice)


@pytest.mark.parametrize("moves", [True, False])
def test_texture_as_fine_as_noise_is_a_scene_only_where_neighbours_match(moves):
    size, pitch, ratio = (620, 500), 24.3, -0.3
    rng = np.random.default_rng(5)
    lattice = lfcal.Lattice([300.2, 250.7], [[pitch, 0.4], [-0.4, pitch]], size, 10.0)
    # Detail of the width of a pixel in the microimages.
    scene = cv2.GaussianBlur(rng.standard_normal((size[1] + 200, size[0] + 200)), (0, 0), 0.8 / -ratio)
    y, x = np.mgrid[: size[1], : size[0]].astype(np.float32)
    centre = lattice.points(np.rint(lattice.to_index(np.column_stack([x.ravel(), y.ravel()]))))
    cx, cy = centre.T.reshape(2, *x.shape).astype(np.float32)
    place = [c - (p - c) / ratio + 100 for p, c in ((x, cx), (y, cy))]
    shown = cv2.remap(scene, *place, cv2.INTER_LINEAR) if moves else rng.standard_normal(x.shape)
    picture = (1 + 0.1 * shown / shown.std()).astype(np.float32)
    found = compare_neighbours(picture, lattice)
    assert found.texture < 2 * found.typical_noise / 1.128
    assert shows_scene(picture, lattice) == moves
