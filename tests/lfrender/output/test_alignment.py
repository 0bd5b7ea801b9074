"""Pictures, views and depth of one flat have one size and affine, and show a mark at one place."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import lfrender
from data_synth import SCENES, Camera, Patch, Scene, simulate
from lfrender.data.dense_depth import dense_depth
from lfrender.output.depth_picture import depth_picture

RATIO, NEAR = -0.35, -0.22  # s / D of a wall and of a card before it


@functools.cache
def outputs():
    """Everything that is drawn from a flat with a bright card before a wall, at the default scale."""
    camera = Camera.design(size=(420, 360), pitch=22.0, rotation=1.0)
    (wall,) = SCENES["plane"](camera, ratio=RATIO, seed=2).surfaces
    place = camera.place((198.0, 171.0), camera.depth_at(NEAR))
    side = np.linalg.norm(camera.place((198.0 + 6 * 22.0, 171.0), place[2]) - place)
    texture = np.random.default_rng(1).uniform(0.4, 1.0, (18, 18, 3)).astype(np.float32)
    card = Patch(place - [side / 2, side / 2, 0.0], np.array([side, 0, 0]), np.array([0, side, 0]), texture)
    dim = Patch(wall.corner, wall.across, wall.down, wall.texture[..., :3] * np.float32([0.02, 0.5, 0.5]))
    shot = simulate(Scene("card", (dim, card)), camera, samples=32, seed=1)
    calibration = shot.truth.calibration
    depth = lfrender.analyze(shot.flat, calibration)
    (view,) = lfrender.views(shot.flat, calibration, depth, offsets=[(0.0, 0.0)])
    return {
        "render": lfrender.render(shot.flat, calibration, depth),
        "refocus": lfrender.refocus(shot.flat, calibration, NEAR * 22.0, depth=depth),
        "view": view,
        "dense": dense_depth(depth),
        "depth picture": depth_picture(depth),
    }


@pytest.mark.parametrize("name", ["refocus", "view", "dense", "depth picture"])
def test_outputs_of_one_flat_have_one_size_and_affine_and_show_a_mark_at_one_place(name):
    first, other = outputs()["render"], outputs()[name]
    pixels = np.asarray(other).astype(float)
    np.testing.assert_array_equal(other.affine, first.affine)
    assert pixels.shape[:2] == first.image.shape[:2]
    assert np.abs(middle_of_card(pixels) - middle_of_card(np.asarray(first).astype(float))).max() < 0.5, "[px]"


def middle_of_card(pixels):
    """u, v of the middle of what differs from the border of the picture, in the channel where it differs most."""
    planes = pixels.reshape(*pixels.shape[:2], -1)
    height, width = planes.shape[:2]
    border = np.median(planes[: height // 5], axis=(0, 1))
    inside = planes[height // 2 - 3 : height // 2 + 3, width // 2 - 3 : width // 2 + 3].mean((0, 1))
    k = int(np.abs(inside - border).argmax())
    card = (planes[..., k] - border[k]) / (inside[k] - border[k]) > 0.5
    edge = height // 5
    card[:edge] = card[-edge:] = False
    card[:, :edge] = card[:, -edge:] = False
    v, u = np.nonzero(card)
    return np.array([u.mean(), v.mean()])


def test_pictures_stand_for_their_pixels_and_know_where_they_lie():
    xarray = pytest.importorskip("xarray", reason="xarray needs lfrender[xarray]")
    picture, dense = outputs()["render"], outputs()["dense"]
    np.testing.assert_array_equal(np.asarray(picture), picture.image)
    found = picture.to_xarray()
    assert isinstance(found, xarray.DataArray) and found.dims == ("y", "x", "channel")
    u, v = 17, 9
    np.testing.assert_allclose([found.x[u], found.y[v]], picture.affine @ [u, v, 1])
    np.testing.assert_array_equal(dense.to_xarray().coords["validity"], dense.validity)
