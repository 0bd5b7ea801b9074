"""Views: parallax as the optics predict, uncovered surfaces, and the files that views are written
to.
"""

from __future__ import annotations

import dataclasses
import functools
import json

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

import lfcal
import lfrender
from data_synth import SCENES, Camera, Scene, simulate
from data_synth.simulator import true_view
from lfrender.cli.main import main
from lfrender.data.surface import Surface
from lfrender.output.views import write_animation
from lfrender.rendering.viewpoints import circle_offsets, grid_offsets

SIZE = (420, 340)
PITCH = 23.2
FAR = 0.3
NEAR = -0.3


@functools.cache
def camera():
    return Camera.design(size=SIZE, pitch=PITCH, rotation=1.3)


@functools.cache
def capture(scene, **arguments):
    shot = simulate(SCENES[scene](camera(), **arguments), camera(), samples=24, seed=2)
    return shot, lfrender.analyze(shot.flat, shot.truth.calibration)


def two_planes():
    """A card at `NEAR`, over the middle two fifths of the width, before a plane at `FAR`."""
    (far,), (near,) = (
        SCENES["plane"](camera(), ratio=ratio, seed=seed).surfaces
        for ratio, seed in ((FAR, 1), (NEAR, 2))
    )
    left, right = camera().place([(0.3 * SIZE[0], 0), (0.7 * SIZE[0], 0)], camera().depth_at(NEAR))
    card = dataclasses.replace(
        near,
        corner=np.array([left[0], *near.corner[1:]]),
        across=near.across * (right[0] - left[0]) / near.across[0],
        texture=near.texture[
            :, : int(near.texture.shape[1] * (right[0] - left[0]) / near.across[0])
        ],
    )
    return Scene("two planes", (far, card))


@functools.cache
def card_before_plane():
    """The capture of two planes, and its true depth."""
    shot = simulate(two_planes(), camera(), samples=24, seed=2)
    depth = lfrender.analyze(shot.flat, shot.truth.calibration)
    surface = Surface(
        shot.truth.reference_patch_size, tuple(shot.truth.reference_affine[:, 2]), 2.0
    )
    assert shot.truth.reference_affine[0, 0] == surface.spacing
    return shot, dataclasses.replace(depth, surface=surface)


def move(before, after, part, about=0):
    """How far the content of `after` lies from that of `before` [output px], order x, y, near
    `about` columns.
    """
    pictures = [picture.image.astype(float).mean(axis=2) for picture in (before, after)]
    pictures[1] = np.roll(pictures[1], -about, axis=1)
    pictures = [picture[part] for picture in pictures]
    window = cv2.createHanningWindow(pictures[0].shape[::-1], cv2.CV_64F)
    return np.array([about, 0]) + cv2.phaseCorrelate(*pictures, window)[0]


def test_the_view_from_the_middle_is_the_all_in_focus_picture():
    shot, depth = capture("slope")
    flat = shot.flat
    calibration = shot.truth.calibration
    (view,) = lfrender.views(flat, calibration, depth, offsets=[(0, 0)])
    picture = lfrender.render(flat, calibration, depth, detail="off")
    np.testing.assert_array_equal(view.image, picture.image)
    np.testing.assert_array_equal(view.affine, picture.affine)
    np.testing.assert_array_equal(view.valid, picture.valid)


@pytest.mark.parametrize("ratio", [-0.35, 0.3])
def test_a_plane_moves_by_the_offset_times_its_virtual_depth(ratio):
    shot, depth = capture("plane", ratio=ratio)
    q = 0.7 * shot.truth.calibration.lattice.radius
    # At a scale by which phase correlation of the texture is not misled to another peak.
    scale = abs(ratio) * PITCH
    middle, right, up = lfrender.views(
        shot.flat,
        shot.truth.calibration,
        depth,
        offsets=[(0, 0), (q, 0), (0, -q)],
        still=np.inf,
        scale=scale,
    )
    expected = q / (ratio * PITCH) * middle.scale
    inner = np.s_[25:-25, 25:-25]
    np.testing.assert_allclose(move(middle, right, inner), [expected, 0], atol=0.2)
    np.testing.assert_allclose(move(middle, up, inner), [0, -expected], atol=0.2)
    (still,) = lfrender.views(
        shot.flat, shot.truth.calibration, depth, offsets=[(q, 0)], scale=scale
    )
    np.testing.assert_allclose(move(middle, still, inner), [0, 0], atol=0.2)


def test_near_objects_move_to_the_left_of_far_ones_when_the_view_moves_to_the_right():
    shot, depth = card_before_plane()
    q = 0.6 * shot.truth.calibration.lattice.radius
    middle, right = lfrender.views(
        shot.flat,
        shot.truth.calibration,
        depth,
        offsets=[(0, 0), (q, 0)],
        scale=8,
        still=FAR * PITCH,
    )
    width = middle.image.shape[1]
    card, beside = (
        np.s_[15:-15, int(a * width) : int(b * width)] for a, b in ((0.36, 0.64), (0.75, 0.95))
    )
    expected = q * 8 * (1 / NEAR - 1 / FAR) / PITCH
    assert expected < -12
    np.testing.assert_allclose(move(middle, right, card, round(expected)), [expected, 0], atol=0.2)
    np.testing.assert_allclose(move(middle, right, beside), [0, 0], atol=0.2)


def test_views_are_images_of_a_pinhole_there_behind_depth_edges_too():
    shot, depth = card_before_plane()
    q = 0.6 * shot.truth.calibration.lattice.radius
    border = 20
    errors = []
    for offset in ((0.0, 0.0), (q, 0.0)):
        (view,) = lfrender.views(
            shot.flat, shot.truth.calibration, depth, offsets=[offset], scale=8, still=FAR * PITCH
        )
        # The affine holds where the far plane lies; the pinhole picture is wanted on the microlens
        # plane.
        affine = view.affine + np.column_stack([np.zeros((2, 2)), np.array(offset) / FAR])
        reference = 255 * true_view(
            two_planes(), camera(), offset, affine, view.image.shape[1::-1], seed=1
        )
        inner = np.s_[border:-border, border:-border]
        picture = view.image.astype(float)[inner]
        reference = reference[inner]
        gain = (picture * reference).sum() / (picture**2).sum()
        errors.append(10 * np.log10(255**2 / np.mean((gain * picture - reference) ** 2)))
    assert errors[0] > 25, "PSNR from the middle [dB]"
    assert errors[1] > 25, "PSNR from the side [dB]"


def test_offsets_outside_the_microimages_and_impossible_numbers_are_refused():
    shot, depth = capture("slope")
    calibration = shot.truth.calibration
    for arguments in (
        {"offsets": [(calibration.lattice.radius, 1.0)]},
        {"offsets": [(np.nan, 0.0)]},
        {"offsets": [(1.0, 2.0, 3.0)]},
        {"offsets": [(0, 0)], "still": 0.0},
        {"offsets": [(0, 0)], "still": np.nan},
        {"offsets": [(0, 0)], "scale": -1.0},
    ):
        with pytest.raises(ValueError):
            lfrender.views(shot.flat, calibration, depth, **arguments)


def test_viewpoints_lie_on_a_grid_from_the_top_left_and_on_a_circle():
    assert grid_offsets(1, 3, 4.0) == [(-4.0, 0.0), (0.0, 0.0), (4.0, 0.0)]
    grid = np.array(grid_offsets(3, 3, 4.0))
    np.testing.assert_allclose(
        grid[[0, 1, 3, 8]], [(-(8**0.5),) * 2, (0, -(8**0.5)), (-(8**0.5), 0), (8**0.5,) * 2]
    )
    np.testing.assert_allclose(
        circle_offsets(4, 2.0), [(2, 0), (0, 2), (-2, 0), (0, -2)], atol=1e-12
    )


@pytest.mark.parametrize("suffix", [".gif", ".png", ".webp"])
def test_an_animation_holds_all_frames_and_repeats(tmp_path, suffix):
    shot, depth = capture("slope")
    q = 0.7 * shot.truth.calibration.lattice.radius
    views = list(
        lfrender.views(
            shot.flat, shot.truth.calibration, depth, offsets=[(-q, 0), (0, 0), (q, 0)], scale=6
        )
    )
    write_animation(tmp_path / f"a{suffix}", views, milliseconds=100)
    with Image.open(tmp_path / f"a{suffix}") as file:
        assert file.n_frames == 3
        assert file.info.get("loop") == 0
        for index, view in enumerate(views):
            file.seek(index)
            assert np.abs(np.asarray(file.convert("RGB"), float) - view.image).mean() < 12
            assert file.info["duration"] == 100


def run(*arguments):
    return CliRunner().invoke(main, [str(a) for a in ("views", *arguments)], catch_exceptions=False)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Flat, camera and depth of a slope."""
    folder = tmp_path_factory.mktemp("slope")
    shot, depth = capture("slope")
    shot.save(folder)
    depth.save(folder / "depth.npz")
    return (
        folder / "flat.png",
        "-c",
        folder / "camera.json",
        "--depth",
        folder / "depth.npz",
        "--scale",
        6,
    )


def test_the_command_writes_a_grid_a_stereo_pair_and_an_animation(files, tmp_path):
    result = run(*files, "-o", tmp_path / "grid", "--grid", "2x3", "--format", "png", "--json")
    assert result.exit_code == 0, result.output
    assert len(json.loads(result.stdout)["offsets"]) == 6
    names = [f"row{row}_column{column}.png" for row in (1, 2) for column in (1, 2, 3)]
    assert sorted(p.name for p in (tmp_path / "grid").iterdir()) == names
    one = lfcal.read_flat(tmp_path / "grid" / names[0])

    assert (
        run(*files, "-o", tmp_path / "pair.png", "--stereo", "--aperture", 0.5, "--quiet").exit_code
        == 0
    )
    shot, depth = capture("slope")
    q = 0.5 * shot.truth.calibration.lattice.radius
    left, right = lfrender.views(
        shot.flat, shot.truth.calibration, depth, offsets=[(-q, 0), (q, 0)], scale=6
    )
    assert left.image.shape == one.shape
    np.testing.assert_array_equal(
        lfcal.read_flat(tmp_path / "pair.png"), np.hstack([left.image, right.image])
    )

    assert run(*files, "-o", tmp_path / "round.gif", "--animation", 4, "--quiet").exit_code == 0
    with Image.open(tmp_path / "round.gif") as file:
        assert file.n_frames == 4
