"""One frame after another: what is kept of depth and picture, what is not, and that keeping makes no difference."""

from __future__ import annotations

import gc
from dataclasses import replace

import numba
import numpy as np
import pytest

import lfrender
from lfcal import Calibration, Lattice, OutputError
from lfrender.depth.changed_lenses import find_changed_lenses
from lfrender.depth.estimate import PreviousEstimates
from lfrender.depth.incremental import LocalMatch, changed_since, find_moved, load_reference_match
from lfrender.flat.lens_graph import neighbour_rows
from lfrender.runtime.cache import cached

# The part of the second flat, order x0, y0, x1, y1, that shows something else.
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


def following(house, first, flat):
    calibration = house.truth.calibration
    depth = lfrender.analyze(flat, calibration, "fast", previous=first[:2])
    return depth, lfrender.render(flat, calibration, depth, previous=first)


def test_a_still_scene_keeps_its_picture_to_the_bit_through_noise(house, first):
    flat = noisy(house.flat, 2)
    depth, picture = following(house, first, flat)
    anew = lfrender.render(flat, house.truth.calibration, depth).image
    assert depth.saved["still"] > 0.98
    assert (picture.image == first[2].image).all(2).mean() > 0.98
    assert (anew == first[2].image).all(2).mean() < 0.5
    np.testing.assert_array_equal(picture.valid, first[2].valid)


def test_what_has_changed_is_drawn_as_in_a_new_picture_and_the_rest_stays(house, first, second):
    depth, picture = following(house, first, second)
    new = lfrender.render(second, house.truth.calibration, depth, scale=picture.scale)
    assert picture.scale == first[2].scale and picture.image.shape == first[2].image.shape
    as_new, as_old = ((picture.image == other.image).all(2) for other in (new, first[2]))
    assert (as_new | as_old).all()
    v, u = np.mgrid[: new.image.shape[0], : new.image.shape[1]]
    x, y = (new.affine[k, 0] * u + new.affine[k, 1] * v + new.affine[k, 2] for k in (0, 1))
    x0, y0, x1, y1 = PART
    assert as_new[(x > x0) & (x < x1) & (y > y0) & (y < y1)].all()
    far = 8 * depth.pitch
    away = (x > x1 + far) | (y > y1 + far)
    assert away.sum() > 0.05 * away.size and as_old[away].all()


def test_a_picture_follows_whether_the_depth_did_or_not(house, first, second):
    calibration = house.truth.calibration
    depth, picture = following(house, first, second)
    fresh = replace(depth)
    np.testing.assert_array_equal(
        changed_since(first[1], fresh, first[0], second, calibration),
        changed_since(first[1], depth, first[0], second, calibration),
    )
    again = lfrender.render(second, calibration, fresh, previous=first)
    np.testing.assert_array_equal(again.image, picture.image)


def test_a_following_frame_is_the_same_on_one_thread(house, first, second):
    depth, picture = following(house, first, second)
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        alone, drawn = following(house, first, second)
    finally:
        numba.set_num_threads(threads)
    np.testing.assert_array_equal(alone.surface.patch_size, depth.surface.patch_size)
    np.testing.assert_array_equal(alone.patch_size, depth.patch_size)
    np.testing.assert_array_equal(drawn.image, picture.image)


def test_a_chain_of_frames_is_the_same_whether_the_last_one_is_at_hand_or_not(house, first, second):
    calibration = house.truth.calibration
    third = second[::-1, ::-1].copy()
    third[100:] = second[100:]

    def chain(forget):
        after, _ = following(house, first, second)
        if forget:
            cached(calibration, "latest frame", list).clear()
        return lfrender.analyze(third, calibration, "fast", previous=(second, after))

    quick, slow = chain(forget=False), chain(forget=True)
    assert 0 < quick.saved["steady"] < 1
    np.testing.assert_array_equal(quick.patch_size, slow.patch_size)
    np.testing.assert_array_equal(quick.surface.patch_size, slow.surface.patch_size)


def test_other_texture_at_the_same_depth_keeps_it_and_at_another_depth_does_not(drawn_flat):
    one, lattice, _, inner = drawn_flat(7.0, noise=0.004)
    calibration = Calibration(lattice)
    before = lfrender.analyze(one.image, calibration, "fast")
    same, closer = drawn_flat(7.0, noise=0.004, seed=6)[0].image, drawn_flat(8.0, noise=0.004, seed=6)[0].image
    after = lfrender.analyze(same, calibration, "fast", previous=(one.image, before))
    assert after.saved["still"] < 0.1 and after.saved["steady"] > 0.6
    assert (after.patch_size == before.patch_size)[inner].mean() > 0.9
    moved = lfrender.analyze(closer, calibration, "fast", previous=(one.image, before))
    assert np.nanmedian(moved.patch_size[inner]) == pytest.approx(8.0, abs=0.05)
    unchecked = lfrender.analyze(
        same, calibration, "fast", previous=(one.image, before), skip=("blank", "ranges", "plane", "still")
    )
    assert "steady" not in unchecked.saved


@pytest.mark.parametrize(("error", "asked"), [(0.01, True), (0.1, False)])
def test_what_noise_alone_may_have_moved_is_not_asked_again(error, asked):
    lattice = Lattice((20.0, 20.0), ((23.2, 0.0), (0.0, 23.2)), (240, 240), 11.0)
    count = len(lattice)
    every, none = np.ones(count, bool), np.zeros(count, np.float32)
    then = LocalMatch(none, none, np.full(count, error, np.float32), every, every)
    # Twice the least motion that is looked at, of all lenses to one side.
    now = replace(then, offset=np.full(count, 0.2, np.float32))
    found, _ = find_moved(then, now, every, np.zeros(count, np.int8), neighbour_rows(lattice, lattice.steps))
    assert found.all() if asked else not found.any()


@pytest.mark.parametrize(("moved", "worse", "in_doubt"), [(0.01, 0.0, False), (0.06, 0.0, True), (0.0, 0.1, True)])
def test_lenses_beside_one_with_another_depth_are_in_doubt_where_anything_has_changed(moved, worse, in_doubt):
    lattice = Lattice((20.0, 20.0), ((23.2, 0.0), (0.0, 23.2)), (240, 240), 11.0)
    count = len(lattice)
    every, none = np.ones(count, bool), np.zeros(count, np.float32)
    then = LocalMatch(none, none, np.full(count, 0.01, np.float32), every, every)
    now = replace(then, offset=np.full(count, moved, np.float32), cost=np.full(count, worse, np.float32))
    neighbours = neighbour_rows(lattice, lattice.steps)
    found, doubtful = find_moved(then, now, every, np.zeros(count, np.int8), neighbours)
    assert not found.any() and doubtful.all() == doubtful.any() == in_doubt
    # Without an answer there is nothing to be sure of.
    assert find_moved(then, then, ~every, np.ones(count, np.int8), neighbours)[1].all()


def test_a_depth_that_changes_little_by_little_is_found_in_the_end(drawn_flat):
    flat, lattice, _, inner = drawn_flat(7.0)
    calibration = Calibration(lattice)
    depth = lfrender.analyze(flat.image, calibration, "fast")
    sizes = np.arange(7.15, 7.8, 0.15)
    for k, s in enumerate(sizes):
        now = drawn_flat(s, seed=6 + k)[0]
        depth = lfrender.analyze(now.image, calibration, "fast", previous=(flat.image, depth))
        flat = now
    assert abs(np.nanmedian(depth.patch_size[inner]) - sizes[-1]) < 0.35


def test_what_coding_does_to_a_still_scene_is_no_change(house):
    calibration = house.truth.calibration
    coded = house.flat.astype(int)
    rng = np.random.default_rng(4)
    for y in range(0, coded.shape[0], 64):
        for x in range(0, coded.shape[1], 64):
            # Some blocks are coded anew, the others are skipped.
            if (x + y) // 64 % 2:
                block = coded[y : y + 64, x : x + 64]
                block += rng.integers(-1, 2, block.shape)
    coded = np.clip(coded, 0, 255).astype(np.uint8)
    assert find_changed_lenses(house.flat, coded, calibration).mean() < 0.02


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scale": 3.0}, "scale"),
        ({"roi": (0, 0, 90, 90)}, "whole picture"),
        ({"sharpen": "auto"}, "whole picture"),
        ({"depth": None, "patch_size": 5.0}, "needs depth"),
    ],
)
def test_a_picture_that_cannot_follow_is_refused(house, first, second, options, message):
    options = {"depth": first[1], **options}
    with pytest.raises(ValueError, match=message):
        lfrender.render(second, house.truth.calibration, previous=first, **options)


def test_a_frame_of_another_kind_is_refused(house, first):
    with pytest.raises(ValueError, match="uint8"):
        lfrender.render(
            house.flat.astype(np.float32) / 255, house.truth.calibration, first[1], previous=first
        )  # fmt: skip


def test_what_is_remembered_is_made_once_and_goes_with_its_owner():
    class Owner:
        pass

    made = []
    owner = Owner()
    for _ in range(3):
        assert cached(owner, "a", lambda: made.append(0) or len(made)) == 1
    assert cached(owner, "b", lambda: "other") == "other"
    before = id(owner)
    from lfrender.runtime.cache import _entries

    assert before in _entries
    del owner
    gc.collect()
    assert before not in _entries


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04 and no more"])
def test_a_damaged_comparison_is_one_clear_error(first, tmp_path, content):
    path = tmp_path / "comparison_000000.npz"
    path.write_bytes(content)
    with pytest.raises(OutputError, match=r"comparison_000000\.npz: damaged .*--overwrite"):
        load_reference_match(first[1], path)


def test_repeating_texture_is_known_from_before_where_most_lenses_were_asked():
    kept = np.arange(20) < 14
    size, sure, none = np.full(20, 5.0, np.float32), np.full(20, 0.9, np.float32), np.zeros(20, np.int8)
    before = PreviousEstimates(kept, size, size, sure, none)
    again, perhaps = before.recurring(np.ones(20, bool))
    assert not again.any() and not perhaps
    # Confidence that was halved for all of them says that it may repeat.
    assert replace(before, confidence=np.float32(0.5) * sure).recurring(np.ones(20, bool))[1]
    assert replace(before, kept=~kept).recurring(np.ones(20, bool)) is None
    assert replace(before, reason=np.where(np.arange(20) == 3, 2, none)).recurring(np.ones(20, bool)) is None
