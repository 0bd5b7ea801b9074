"""Lens types of multi-focus arrays are found where they exist, in the order of their focus, and
nowhere else.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import lfcal
from data_synth import SCENES, Camera, simulate
from lfcal.images.preprocessing import sqrt_luminance
from lfcal.lens_types.classify import find_lens_types
from lfcal.lens_types.lens_sample import measure_lens_features, sample_lenses

KINDS = Path(__file__).resolve().parents[3].parent / "shared" / "kinds"
_FOCI = (-0.5, -0.35, -0.22)
_MOSAIC = np.array([[0, 1, 2], [2, 0, 1], [1, 2, 0]])


def capture(scene, focus, lattice="hex", pitch=18.2, size=(600, 560), rotation=0.0, **kwargs):
    camera = Camera.design(size, pitch, lattice, rotation, focus=focus)
    return simulate(
        SCENES[scene](camera, seed=5, **kwargs), camera, samples=8, noise=(8000, 8), seed=2
    )


def search(picture, lattice, white=False):
    return find_lens_types(sqrt_luminance(picture), lattice, white)


def white_of_types(whites, basis, cell, soft=None, gain=None, size=(580, 520)):
    """White image of which lens (i, j) has the edge width `soft` and the brightness `gain` of its
    type.
    """
    _, origin = whites.white_image(basis, size)
    y, x = np.mgrid[: size[1], : size[0]]
    index = np.rint((np.stack([x, y], -1) - origin) @ np.linalg.inv(basis)).astype(int) % len(cell)
    types = cell[index[..., 0], index[..., 1]]
    kinds = range(cell.max() + 1)
    soft, gain = (np.ones(len(kinds)) if values is None else values for values in (soft, gain))
    drawn = [whites.white_image(basis, size, soft=soft[kind])[0] * gain[kind] for kind in kinds]
    return np.choose(types, drawn).astype(np.uint16), origin


def types_at(camera, origin, basis):
    """Found type of each lens, and its index on the true lattice."""
    true = np.rint((camera.lattice.centres() - origin) @ np.linalg.inv(basis)).astype(int)
    return camera.lens_types.of(camera.lattice.indices()), true


@pytest.mark.parametrize(
    ("lattice", "sign", "rotation"), [("hex-vertical", 1, 7.0), ("square", -1, 2.0)]
)
def test_three_types_are_found_in_a_scene_and_ordered_from_large_to_small_patch_size(
    lattice, sign, rotation
):
    foci = tuple(-sign * f for f in _FOCI)
    taken = capture("slope", foci, lattice, rotation=rotation, left=sign * 0.58, right=sign * 0.16)
    camera = lfcal.calibrate(taken.flat)
    assert (
        camera.lens_types is not None and camera.lens_types.count == 3 and camera.lens_types.ordered
    )
    true = taken.truth.calibration.lattice
    found, index = types_at(camera, true.origin, true.basis)
    np.testing.assert_array_equal(found, (index[:, 0] - index[:, 1]) % 3)
    assert not camera.warnings


def test_types_of_a_white_image_are_found_where_lattice_and_pixels_repeat_like_them():
    # Every third lens lies alike on the pixels, which cut edges differently in the others.
    taken = capture("ramp", _FOCI, pitch=52 / 3)
    camera = lfcal.calibrate(taken.white, kind="white")
    true = taken.truth.calibration.lattice
    found, index = types_at(camera, true.origin, true.basis)
    np.testing.assert_array_equal(found, (index[:, 0] - index[:, 1]) % 3)


def test_types_are_found_without_detail_by_the_blur_of_their_rims():
    taken = capture("ramp", _FOCI)
    lattice = taken.truth.calibration.lattice
    types = search(taken.flat, lattice)
    np.testing.assert_array_equal(types.of(lattice.indices()), taken.truth.lens_type)
    assert types.ordered and np.isnan(types.focus).all()


@pytest.mark.parametrize(("scene", "focus"), [("clutter", -0.3)])
def test_single_type_array_is_not_split(scene, focus):
    # At this pitch each third lens meets the pixels alike, which must not be taken for a type.
    taken = capture(scene, focus, pitch=70 / 3, size=(520, 500))
    for picture, white in ((taken.flat, False), (taken.white, True)):
        assert search(picture, taken.truth.calibration.lattice, white) is None


def test_scene_that_repeats_every_third_lens_is_not_taken_for_types(whites):
    basis = whites.turned(whites.HEXAGON, 22.5, 3)
    size = (580, 520)
    image, origin = whites.white_image(basis, size)
    offset = np.stack(np.mgrid[: size[1], : size[0]][::-1], -1) - origin
    index = np.rint(offset @ np.linalg.inv(basis))
    # A grating so coarse that one lens sees its crest and the next its slope.
    within = (offset - index @ basis)[..., 0] / 30.0
    scene = 1 + 0.4 * np.sin(2 * np.pi * (within + (index[..., 0] - index[..., 1]) / 3))
    lattice = lfcal.Lattice(origin, basis, size, 10.3)
    assert search(image * scene, lattice) is None
    features = measure_lens_features(sqrt_luminance(image * scene), sample_lenses(lattice))
    sample = sample_lenses(lattice)
    contrast = sample.subtract_neighbours(features.sharpness)
    third = (sample.inner[:, 0] - sample.inner[:, 1]) % 3
    assert np.ptp([np.nanmean(contrast[third == kind]) for kind in range(3)]) > 0.2


@pytest.mark.parametrize(("shape", "step"), [("SQUARE", (0, 1)), ("HEXAGON", (1, 0))])
def test_rows_of_text_are_not_taken_for_types(whites, shape, step):
    basis = whites.turned(getattr(whites, shape), 22.5, 3)
    size = (580, 520)
    image, origin = whites.white_image(basis, size)
    offset = np.stack(np.mgrid[: size[1], : size[0]][::-1], -1) - origin
    index = np.rint(offset @ np.linalg.inv(basis))
    row = (index @ step).astype(int) % 3
    # Letters: fine waves of a phase of their own in each lens, strong in each third row.
    phase = np.random.default_rng(5).uniform(0, 2 * np.pi, (99, 99))
    within = (offset - index @ basis)[..., 0] / 6
    own = phase[tuple(np.moveaxis(index.astype(int), -1, 0) % 99)]
    scene = 1 + np.array([0.1, 0.2, 0.4])[row] * np.sin(2 * np.pi * within + own)
    assert search(image * scene, lfcal.Lattice(origin, basis, size, 10.3)) is None


@pytest.mark.parametrize(("shape", "pitch"), [("SQUARE", 19.5), ("HEXAGON", 21.0)])
def test_white_image_of_equal_lenses_has_one_type_at_any_beat_with_the_pixels(whites, shape, pitch):
    basis = whites.turned(getattr(whites, shape), pitch, 0)
    for soft in (1.0, 4.0):
        image, origin = whites.white_image(basis, (620, 560), soft=soft, noise=0.0)
        assert (
            search(image, lfcal.Lattice(origin, basis, (620, 560), 0.46 * pitch), white=True)
            is None
        )


@pytest.mark.parametrize(
    ("shape", "cell", "soft"),
    [
        ("HEXAGON", _MOSAIC, (5.0, 3.0, 1.0)),
        ("SQUARE", np.array([[0, 2], [3, 1]]), (7.0, 5.0, 3.0, 1.0)),
    ],
)
def test_white_image_orders_types_from_soft_to_sharp_rims(whites, shape, cell, soft):
    basis = whites.turned(getattr(whites, shape), 22.3, 3)
    image, origin = white_of_types(whites, basis, cell, soft=soft)
    camera = lfcal.calibrate(image)
    assert camera.lens_types.count == len(soft) and camera.lens_types.ordered
    found, index = types_at(camera, origin, basis)
    np.testing.assert_array_equal(found, cell[tuple((index % len(cell)).T)])


def test_types_that_differ_in_brightness_alone_are_found_without_an_order(whites):
    basis = whites.turned(whites.HEXAGON, 22.3, 90)
    image, origin = white_of_types(whites, basis, _MOSAIC, gain=(1.0, 0.95, 0.9))
    camera = lfcal.calibrate(image)
    found, index = types_at(camera, origin, basis)
    true = _MOSAIC[tuple((index % 3).T)]
    assert len({*zip(found.tolist(), true.tolist(), strict=True)}) == camera.lens_types.count == 3
    assert not camera.lens_types.ordered
    assert any("3 lens types" in warning for warning in camera.warnings)


def test_real_capture_shows_the_types_its_camera_has(shared):
    found = lfcal.calibrate(lfcal.read_flat(shared("captures", "Fujita2.png"))).lens_types
    assert found.count == 3 and found.ordered and found.confidence > 0.9
    # Sharpness changes places at |s| of about 8 and 6.5 px of 23.2; foci run from large |s| to
    # small.
    assert np.isfinite(found.focus).all()
    assert (np.diff(found.focus) > 0).all()
    assert -0.45 < found.focus[0] < found.focus[2] < -0.15


def test_types_that_change_places_with_depth_are_found_without_rims(shared):
    camera = lfcal.calibrate(lfcal.read_flat(shared("captures", "TempleBoatGiantR32.webp")))
    assert camera.lens_types.count == 3 and camera.lens_types.ordered


@pytest.mark.parametrize("folder", ["s3_r5", "s5b_tspc"])
def test_ray_traced_single_type_cameras_are_not_split(shared, folder):
    truth = json.loads(shared("truth", folder, "truth.json").read_text())["camera"]
    for name, white in (("flat.png", False), ("white.png", True)):
        picture = lfcal.read_flat(shared("truth", folder, name))
        size = (truth["W"], truth["H"])
        lattice = lfcal.Lattice(truth["origin_px"], truth["basis_px"], size, 0.47 * truth["D"])
        assert search(picture, lattice, white) is None


@pytest.mark.parametrize("shares", [(1.0, 1.0), (1.0, 0.9)])
def test_two_types_of_unlike_radius_are_found_on_a_white_image_and_alike_ones_are_not(shares):
    camera = Camera.design((500, 450), 30.3, "square", -1.3, microimage_fill=0.94)
    focal = camera.microlens_focal_lengths[0]
    camera = camera.replace(
        microlens_focal_lengths=(focal, focal), type_apertures=shares, stray=0.05
    )
    taken = simulate(SCENES["blank"](camera), camera, samples=8, noise=(9000, 5), gamma=False)
    found = lfcal.calibrate(taken.white, kind="white")
    assert (found.lens_types is not None) == (shares[0] != shares[1])
    index = found.lattice.indices()
    if found.lens_types is not None:
        near = taken.truth.calibration.lattice.to_index(found.lattice.points(index)).round()
        assert (
            len(
                {
                    (int(a), int(b) % 2)
                    for a, b in zip(found.lens_types.of(index), near.sum(1), strict=True)
                }
            )
            == 2
        )


@pytest.mark.skipif(
    not KINDS.is_dir(), reason="no white images of other kinds beside the repository"
)
def test_alternating_types_with_like_rims_are_found_by_the_light_before_them():
    camera = lfcal.calibrate(KINDS / "types2_sq.png")
    assert camera.lens_types is not None and camera.lens_types.count == 2
    assert camera.confidence > 0.9
    light = camera.flatten(lfcal.read_flat(KINDS / "types2_sq.png").astype(np.float32))
    kind = camera.lens_types.of(camera.lattice.indices())
    centres = camera.lattice.centres()
    inside = ((centres > 40) & (centres < np.array(camera.image_size) - 40)).all(1)
    y, x = np.mgrid[-15:16, -15:16]
    rim = {0: [], 1: []}
    for (u, v), of in zip(centres[inside][::5], kind[inside][::5], strict=True):
        column = round(u)
        row = round(v)
        far = np.hypot(x + column - u, y + row - v) / camera.lattice.radius
        window = light[row - 15 : row + 16, column - 15 : column + 16]
        rim[int(of)].append(window[(far > 0.9) & (far < 0.98)].mean() / window[far < 0.5].mean())
    # One profile for both leaves them 0.6 and 1.3 times as bright at the rim as in the middle.
    assert all(np.mean(values) == pytest.approx(1, abs=0.15) for values in rim.values())
