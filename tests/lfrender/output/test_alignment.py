"""Pictures, views and depth of one flat have one size and affine, and show a mark at one place."""

from __future__ import annotations

import functools
import itertools
import json
import tempfile
from pathlib import Path

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

import lfrender
from data_synth import SCENES, Camera, Patch, Scene, simulate
from lfrender.cli.main import main
from lfrender.data.dense_depth import dense_depth, write_dense
from lfrender.output.depth_picture import depth_picture
from lfrender.output.point_cloud import point_cloud

PITCH = 22.0  # [px]; s / D of a wall and of a card before it
RATIO = -0.35
NEAR = -0.22


GRID = (
    "render",
    "refocus",
    "focal stack",
    "view",
    "dense",
    "depth picture",
    "dense file",
    "picture file",
    "commands",
)


@functools.cache
def capture():
    """Flat, camera and depth of a bright card before a wall."""
    camera = Camera.design(size=(420, 360), pitch=PITCH, rotation=1.0)
    (wall,) = SCENES["plane"](camera, ratio=RATIO, seed=2).surfaces
    place = camera.place((198.0, 171.0), camera.depth_at(NEAR))
    side = np.linalg.norm(camera.place((198.0 + 6 * PITCH, 171.0), place[2]) - place)
    texture = np.random.default_rng(1).uniform(0.4, 1.0, (18, 18, 3)).astype(np.float32)
    # Turned, so that its middle does not depend on where pixels lie.
    across, down = side * np.array([[0.94, 0.34, 0.0], [-0.34, 0.94, 0.0]])
    card = Patch(place - (across + down) / 2, across, down, texture)
    dim = Patch(
        wall.corner, wall.across, wall.down, wall.texture[..., :3] * np.float32([0.02, 0.5, 0.5])
    )
    shot = simulate(Scene("card", (dim, card)), camera, samples=32, seed=1)
    calibration = shot.truth.calibration
    return shot.flat, calibration, lfrender.analyze(shot.flat, calibration)


@functools.cache
def outputs():
    """Everything that is drawn from it, by name; those of `GRID` at the default scale."""
    flat, calibration, depth = given = capture()
    (view,) = lfrender.views(*given, offsets=[(0.0, 0.0)])
    made = {
        "render": lfrender.render(*given),
        "refocus": lfrender.refocus(flat, calibration, NEAR * PITCH, depth=depth),
        "focal stack": lfrender.focal_stack(
            flat, calibration, [NEAR * PITCH, RATIO * PITCH], depth=depth
        )[0],
        "view": view,
        "dense": dense_depth(depth),
        "depth picture": depth_picture(depth),
        "part": lfrender.render(*given, roi=(20, 15, 390, 350)),
        "other scale": lfrender.render(*given, scale=5),
        "one patch size": lfrender.render(flat, calibration, patch_size=NEAR * PITCH, blend=True),
        "traditional": lfrender.traditional(flat, calibration),
    }
    return made | {name: File(path) for name, path in files(made, flat, calibration, depth).items()}


def files(made, flat, calibration, depth):
    """What is written: by functions, and by a command that finds its own depth."""
    folder = Path(tempfile.mkdtemp())
    write_dense(folder / "dense.tif", made["dense"])
    lfrender.write_picture(folder / "picture.tif", made["render"])
    lfrender.write_picture(folder / "flat.png", flat)
    calibration.save(folder / "camera.json")
    depth.save(folder / "depth.npz")
    words = ["refocus", "flat.png", "-c", "camera.json", "--depth", "depth.npz", "-o", "focus.tif"]
    words = [str(folder / word) if "." in word else word for word in words]
    assert CliRunner().invoke(main, [*words, "--patch-size", str(NEAR * PITCH)]).exit_code == 0
    names = {"dense file": "dense.tif", "picture file": "picture.tif", "commands": "focus.tif"}
    return {name: folder / file for name, file in names.items()}


class File:
    """The first page of a TIFF, and the affine that it holds."""

    def __init__(self, path):
        with tifffile.TiffFile(path) as tiff:
            self.pixels = tiff.pages[0].asarray()
            self.affine = np.array(json.loads(tiff.pages[0].description)["affine"])

    def __array__(self, dtype=None, copy=None):
        return np.array(self.pixels, dtype)


def marks():
    """Scene coordinates of the middle of the card, and the spacing of pixels [px of the flat], by
    output.
    """
    found = {}
    for name, output in outputs().items():
        u, v = middle_of_card(np.asarray(output).astype(float))
        found[name] = output.affine @ [u, v, 1.0], output.affine[0, 0]
    points = point_cloud(*capture())
    points = points[points["z"] < 2 / (NEAR + RATIO)]
    found["point cloud"] = PITCH * np.array([points["x"].mean(), points["y"].mean()]), PITCH / 7
    return found


def test_outputs_of_one_flat_have_one_size_and_affine():
    first = outputs()["render"]
    for name in GRID:
        other = outputs()[name]
        np.testing.assert_allclose(other.affine, first.affine, rtol=1e-12, err_msg=name)
        assert np.asarray(other).shape[:2] == first.image.shape[:2], name


def test_a_mark_lies_at_one_place_in_every_pair_of_outputs():
    for (one, (place, step)), (other, (there, wide)) in itertools.combinations(marks().items(), 2):
        assert np.abs(place - there).max() < 0.5 * max(step, wide), (
            f"{one}, {other} [px of the coarser]"
        )


def middle_of_card(pixels):
    """u, v of the middle of what differs from the border of the picture, in the channel where it
    differs most.
    """
    planes = pixels.reshape(*pixels.shape[:2], -1)
    height, width = planes.shape[:2]
    border = np.median(planes[: height // 5], axis=(0, 1))
    half = max(1, height // 16)
    inside = planes[
        height // 2 - half : height // 2 + half, width // 2 - half : width // 2 + half
    ].mean((0, 1))
    k = int(np.abs(inside - border).argmax())
    card = (planes[..., k] - border[k]) / (inside[k] - border[k]) > 0.5
    edge = height // 5
    card[:edge] = card[-edge:] = False
    card[:, :edge] = card[:, -edge:] = False
    v, u = np.nonzero(card)
    return np.array([u.mean(), v.mean()])


def test_pictures_stand_for_their_pixels_and_know_where_they_lie():
    xarray = pytest.importorskip("xarray", reason="xarray needs lfrender[xarray]")
    picture = outputs()["render"]
    dense = outputs()["dense"]
    np.testing.assert_array_equal(np.asarray(picture), picture.image)
    found = picture.to_xarray()
    assert isinstance(found, xarray.DataArray) and found.dims == ("y", "x", "channel")
    u = 17
    v = 9
    np.testing.assert_allclose([found.x[u], found.y[v]], picture.affine @ [u, v, 1])
    np.testing.assert_array_equal(dense.to_xarray().coords["validity"], dense.validity)
