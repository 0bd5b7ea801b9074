"""The next frame: which lenses keep their depth, which do not, and that the picture is the same."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numba
import numpy as np
import pytest

import lfrender
from data_synth import SCENES, Camera, simulate
from lfcal import Calibration, FlatError

# The part of the second flat that differs, order x0, y0, x1, y1.
PART = (60, 50, 210, 170)


def noisy(flat, seed):
    noise = np.random.default_rng(seed).integers(-2, 3, flat.shape)
    return np.clip(flat.astype(int) + noise, 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def first(house):
    flat = noisy(house.flat, 1)
    depth = lfrender.analyze(flat, house.truth.calibration, "fast")
    return flat, depth, lfrender.render(flat, house.truth.calibration, depth)


@pytest.fixture(scope="module")
def second(house):
    """The same again, but for its noise and for a part that is mirrored."""
    x0, y0, x1, y1 = PART
    flat = noisy(house.flat, 2)
    flat[y0:y1, x0:x1] = flat[y0:y1, x0:x1][::-1, ::-1].copy()
    return flat


def update(house, first, flat):
    calibration = house.truth.calibration
    depth = lfrender.analyze(flat, calibration, "fast", previous=first[:2])
    return depth, lfrender.render(flat, calibration, depth, previous=first)


def test_a_still_scene_keeps_its_picture_bit_for_bit_in_spite_of_noise(house, first):
    flat = noisy(house.flat, 2)
    depth, picture = update(house, first, flat)
    anew = lfrender.render(flat, house.truth.calibration, depth).image
    assert depth.saved["still"] > 0.98
    assert (picture.image == first[2].image).all(2).mean() > 0.98
    assert (anew == first[2].image).all(2).mean() < 0.5
    np.testing.assert_array_equal(picture.valid, first[2].valid)


def test_changed_parts_are_rendered_as_in_a_new_picture_and_the_rest_stays(house, first, second):
    calibration = house.truth.calibration
    old = lfrender.render(first[0], calibration, first[1], detail="off")
    depth = lfrender.analyze(second, calibration, "fast", previous=first[:2])
    picture = lfrender.render(second, calibration, depth, previous=(*first[:2], old), detail="off")
    new = lfrender.render(second, calibration, depth, scale=picture.scale, detail="off")
    assert picture.scale == old.scale and picture.image.shape == old.image.shape
    as_new, as_old = ((picture.image == other.image).all(2) for other in (new, old))
    assert (as_new | as_old).all()
    v, u = np.mgrid[: new.image.shape[0], : new.image.shape[1]]
    x, y = (new.affine[k, 0] * u + new.affine[k, 1] * v + new.affine[k, 2] for k in (0, 1))
    x0, y0, x1, y1 = PART
    assert as_new[(x > x0) & (x < x1) & (y > y0) & (y < y1)].all()
    far = 8 * depth.pitch
    away = (x > x1 + far) | (y > y1 + far)
    assert away.sum() > 0.05 * away.size and as_old[away].all()


def test_detail_of_changed_parts_is_restored_with_the_noise_of_the_earlier_picture(
    house, first, second, monkeypatch
):
    depth, picture = update(house, first, second)
    assert picture.noise is first[2].noise is not None
    monkeypatch.setattr("lfrender.rendering.render.measure_noise", lambda *_: first[2].noise)
    new = lfrender.render(second, house.truth.calibration, depth, scale=picture.scale)
    as_new, as_old = ((picture.image == other.image).all(2) for other in (new, first[2]))
    assert (as_new | as_old).all() and not as_old.all()


def test_copies_of_a_depth_map_keep_what_the_next_frame_is_compared_with(house, first, second):
    depth, _ = update(house, first, second)
    assert 0 < depth.frame_state.kept.mean() < 1
    assert replace(depth, saved={}).frame_state is depth.frame_state
    pickled = pickle.loads(pickle.dumps(depth)).frame_state
    np.testing.assert_array_equal(pickled.kept, depth.frame_state.kept)
    np.testing.assert_array_equal(pickled.reference.cost, depth.frame_state.reference.cost)
    assert pickled.previous is None and pickled.changed is None


def test_the_next_frame_is_the_same_on_one_thread(house, first, second):
    depth, picture = update(house, first, second)
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        alone, drawn = update(house, first, second)
    finally:
        numba.set_num_threads(threads)
    np.testing.assert_array_equal(alone.surface.patch_size, depth.surface.patch_size)
    np.testing.assert_array_equal(alone.patch_size, depth.patch_size)
    np.testing.assert_array_equal(drawn.image, picture.image)


def test_a_chain_of_frames_is_the_same_for_a_depth_map_that_was_stored(
    house, first, second, tmp_path
):
    calibration = house.truth.calibration
    third = second[::-1, ::-1].copy()
    third[100:] = second[100:]
    after, _ = update(house, first, second)
    after.save(tmp_path / "depth.npz")
    stored = lfrender.DepthMap.load(tmp_path / "depth.npz")
    quick, slow = (
        lfrender.analyze(third, calibration, "fast", previous=(second, depth))
        for depth in (after, stored)
    )
    assert 0 < quick.saved["steady"] < 1
    np.testing.assert_array_equal(quick.patch_size, slow.patch_size)
    np.testing.assert_array_equal(quick.surface.patch_size, slow.surface.patch_size)


def test_new_texture_keeps_its_depth_if_it_matches_there(drawn_flat):
    one, lattice, _, inner = drawn_flat(7.0, noise=0.004)
    calibration = Calibration(lattice)
    before = lfrender.analyze(one.image, calibration, "fast")
    same = drawn_flat(7.0, noise=0.004, seed=6)[0].image
    closer = drawn_flat(8.0, noise=0.004, seed=6)[0].image
    after = lfrender.analyze(same, calibration, "fast", previous=(one.image, before))
    assert after.saved["still"] < 0.1 and after.saved["steady"] > 0.6
    assert (after.patch_size == before.patch_size)[inner].mean() > 0.9
    moved = lfrender.analyze(closer, calibration, "fast", previous=(one.image, before))
    assert np.nanmedian(moved.patch_size[inner]) == pytest.approx(8.0, abs=0.05)
    unchecked = lfrender.analyze(
        same, calibration, "fast", previous=(one.image, before), skip=("blank", "ranges", "still")
    )
    assert "steady" not in unchecked.saved


def test_slow_changes_of_depth_do_not_accumulate_unnoticed(drawn_flat):
    flat, lattice, _, inner = drawn_flat(7.0)
    calibration = Calibration(lattice)
    depth = lfrender.analyze(flat.image, calibration, "fast")
    sizes = np.arange(7.15, 7.8, 0.15)
    for k, s in enumerate(sizes):
        now = drawn_flat(s, seed=6 + k)[0]
        depth = lfrender.analyze(now.image, calibration, "fast", previous=(flat.image, depth))
        flat = now
    assert abs(np.nanmedian(depth.patch_size[inner]) - sizes[-1]) < 0.35


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scale": 3.0}, "scale"),
        ({"roi": (0, 0, 90, 90)}, "whole picture"),
        ({"depth": None, "patch_size": 5.0}, "needs depth"),
    ],
)
def test_options_that_do_not_go_with_a_previous_picture_raise_an_error(
    house, first, second, options, message
):
    options = {"depth": first[1], **options}
    with pytest.raises(ValueError, match=message):
        lfrender.render(second, house.truth.calibration, previous=first, **options)


def test_a_frame_of_another_kind_raises_an_error(house, first):
    with pytest.raises(ValueError, match="uint8"):
        lfrender.render(
            house.flat.astype(np.float32) / 255, house.truth.calibration, first[1], previous=first
        )


def with_noise(flat, seed):
    noise = np.random.default_rng(seed).normal(0, 2.0, flat.shape)
    return np.clip(np.rint(flat + noise), 0, 255).astype(np.uint8)


def test_a_still_frame_keeps_its_depth_in_spite_of_noise(house):
    calibration = house.truth.calibration
    first = with_noise(house.flat, 1)
    second = with_noise(house.flat, 2)
    before = lfrender.analyze(first, calibration)
    after = lfrender.analyze(second, calibration, previous=(first, before))
    assert after.saved["still"] > 0.98
    same = (after.patch_size == before.patch_size) | (
        np.isnan(after.patch_size) & np.isnan(before.patch_size)
    )
    assert same.mean() > 0.95


def test_only_changed_lenses_are_estimated_again():
    camera = Camera.design(size=(520, 400), pitch=20.3, lattice="hex", rotation=1.3)
    house, other = (
        simulate(scene, camera, samples=16, seed=4)
        for scene in (SCENES["house"](camera), SCENES["plane"](camera, ratio=0.45))
    )
    calibration = house.truth.calibration
    lattice = calibration.lattice
    centres = lattice.centres()
    y, x = np.mgrid[: house.flat.shape[0], : house.flat.shape[1]]
    replaced = (np.abs(x - 260) < 90) & (np.abs(y - 200) < 80)
    second = np.where(replaced[..., None], other.flat, house.flat)
    before = lfrender.analyze(house.flat, calibration)
    after = lfrender.analyze(second, calibration, previous=(house.flat, before))
    afresh = lfrender.analyze(second, calibration)
    middle = (np.abs(centres - (260, 200)) < (50, 40)).all(1)
    assert np.abs(after.patch_size[middle] - 0.45 * lattice.pitch).max() < 0.3
    away = ~(np.abs(centres - (260, 200)) < (170, 160)).all(1)
    np.testing.assert_array_equal(after.patch_size[away], before.patch_size[away])
    assert 0.2 < after.saved["still"] < 0.85
    known = (after.mode != 0) & (afresh.mode != 0)
    assert np.quantile(np.abs(after.patch_size - afresh.patch_size)[known], 0.97) < 0.05


def test_a_previous_frame_of_another_kind_raises_an_error(house):
    calibration = house.truth.calibration
    before = lfrender.analyze(house.flat, calibration, "fast")
    with pytest.raises(FlatError, match="float32"):
        lfrender.analyze(
            house.flat, calibration, "fast", previous=(house.flat / np.float32(255), before)
        )
    with pytest.raises(ValueError, match="preset"):
        lfrender.analyze(house.flat, calibration, previous=(house.flat, before))
