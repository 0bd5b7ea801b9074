"""Shortcuts of the depth analysis: what they leave out, that the answers stay, and what they must not overlook."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

import lfrender
from data_synth import SCENES, Camera, Scene, simulate
from data_synth.scenes import blank, plane
from data_synth.surfaces import Patch
from lfcal import FlatError
from lfrender.depth.changed_lenses import find_changed_lenses
from lfrender.depth.planes.plane_fit import fit_plane, is_nearly_planar
from lfrender.flat import texture

SIZE = (640, 480)


@functools.cache
def camera():
    return Camera.design(size=SIZE, pitch=23.2, lattice="hex", rotation=1.3)


def shot_of(*surfaces, noise=None):
    return simulate(Scene("some", surfaces), camera(), samples=32, seed=2, noise=noise)


def card(ratio, low, high):
    """A textured card at `s / D = ratio` over the flat pixels from `low` to `high`."""
    wide = plane(camera(), ratio=ratio).surfaces[0]
    depth = camera().depth_at(ratio)
    corner, right, below = camera().place([low, (high[0], low[1]), (low[0], high[1])], depth)
    part = wide.texture[:160, : 160 * (high[0] - low[0]) // (high[1] - low[1])]
    return Patch(corner, right - corner, below - corner, part)


@functools.cache
def one_plane():
    return shot_of(*plane(camera(), ratio=0.3).surfaces)


def both(shot, skip=True, **options):
    calibration = shot.truth.calibration
    return lfrender.analyze(shot.flat, calibration, skip=False), lfrender.analyze(
        shot.flat, calibration, skip=skip, **options
    )


def agreement(full, quick):
    """Share of the lenses that are resolved in both, or in neither, and differ by less than 0.05 px."""
    near = np.abs(full.patch_size - quick.patch_size) < 0.05
    return np.mean(near | ((full.mode == 0) & (quick.mode == 0)))


def test_a_plane_is_one_number_as_accurate_as_the_truth():
    shot = one_plane()
    full, quick = both(shot)
    resolved = quick.mode != 0
    assert full.saved == {}
    assert quick.saved["plane"] > 0.7
    assert resolved.mean() > 0.99
    for depth in (full, quick):
        known = depth.patch_size[depth.mode != 0]
        assert np.ptp(known) == 0
        assert abs(known[0] - 0.3 * 23.2) < 0.01
        assert np.abs(depth.surface.patch_size - 0.3 * 23.2).max() < 0.01


@pytest.mark.parametrize(
    ("scene", "options", "noise"),
    [("slope", {}, None), ("plane", {"ratio": -0.5}, (400, 10)), ("slope", {}, (1500, 8))],
)
def test_slanted_and_noisy_planes_are_recognised_and_agree_with_the_exhaustive_search(scene, options, noise):
    shot = shot_of(*SCENES[scene](camera(), **options).surfaces, noise=noise)
    full, quick = both(shot)
    assert quick.saved["plane"] > 0.7
    assert agreement(full, quick) > 0.99
    for depth in (full, quick):
        error = np.abs(depth.patch_size - shot.truth.patch_size)[shot.truth.mode != 0]
        assert np.quantile(error, 0.95) < 0.025


@pytest.mark.parametrize("lattice", ["hex", "square"])
@pytest.mark.parametrize("ratio", [-0.4, 0.3])
def test_planes_of_thousands_of_small_lenses_are_recognised(lattice, ratio):
    small = Camera.design((1000, 800), 14.0, lattice=lattice, rotation=2.0)
    shot = simulate(plane(small, ratio=ratio), small, samples=16, seed=3, noise=(12000, 5))
    # Of so many some match better elsewhere by chance.
    full, quick = both(shot)
    assert quick.saved["plane"] > 0.9
    assert agreement(full, quick) > 0.99


def test_several_depths_are_told_from_what_few_lenses_find_in_whole_pixels():
    rng = np.random.default_rng(4)
    places = rng.uniform(0, 2000, (60, 2))
    slanted = 1 / (1 / 7 + 2e-5 * places[:, 0]) + rng.normal(0, 0.3, 60)
    assert is_nearly_planar(places, slanted, 23.2)
    assert is_nearly_planar(places, np.where(rng.random(60) < 0.1, rng.uniform(-15, 15, 60), slanted), 23.2)
    assert not is_nearly_planar(places, np.where(places[:, 0] > 1200, -6.0, slanted), 23.2)
    assert not is_nearly_planar(places, np.zeros(60), 23.2)


@pytest.mark.parametrize(("scene", "options"), [("slope", {}), ("plane", {"ratio": -0.4}), ("plane", {"ratio": 0.2})])
def test_planes_of_large_microimages_are_found_on_a_smaller_flat_and_measured_on_the_flat_itself(scene, options):
    large = Camera.design(size=(1000, 760), pitch=52.0, lattice="hex", rotation=2.0)
    shot = simulate(SCENES[scene](large, **options), large, samples=24, seed=4, noise=(8000, 4))
    _, quick = both(shot)
    assert quick.saved["plane"] > 0.7
    known = (quick.mode != 0) & (shot.truth.mode != 0)
    error = np.abs(quick.patch_size - shot.truth.patch_size)[known]
    assert np.median(error) < 0.01
    assert np.median(error / quick.standard_error[known]) < 2


def test_a_bend_of_a_tenth_of_a_pixel_is_no_plane():
    rng = np.random.default_rng(3)
    points = rng.uniform(0, 600, (400, 2))
    flat = 1 / (1 / 7 + 2e-5 * points[:, 0]) + rng.normal(0, 0.03, 400)
    bent = flat + 0.1 * np.cos(points[:, 0] / 150)
    plane_found = fit_plane(points, flat, 23.2)
    assert plane_found is not None
    assert np.abs(plane_found.at(points) - 1 / (1 / 7 + 2e-5 * points[:, 0])).max() < 0.01
    assert fit_plane(points, bent, 23.2) is None


def test_a_plane_is_slanted_where_that_is_more_than_chance():
    points = np.random.default_rng(5).uniform(0, 600, (400, 2))
    noise = np.random.default_rng(6).normal(0, 0.01, 400)
    slightly = 7 + 0.02 * (points[:, 0] / 300 - 1)
    slanted, level = fit_plane(points, slightly + noise, 23.2), fit_plane(points, 7 + noise, 23.2)
    assert slanted is not None and slanted.slanted
    assert np.abs(slanted.at(points) - slightly).max() < 0.005
    assert level is not None and not level.slanted
    facing = fit_plane(points, slightly + noise, 23.2, facing=True)
    assert facing is not None and not facing.slanted


def test_a_slightly_slanted_plane_is_measured_as_one():
    """Its few samples do not tell the slant from noise: 0.04 px over the whole flat."""
    shot = simulate(SCENES["slope"](camera(), left=0.199, right=0.201), camera(), samples=24, seed=4, noise=(8000, 4))
    for depth in both(shot):
        error = (depth.patch_size - shot.truth.patch_size)[(depth.mode != 0) & (shot.truth.mode != 0)]
        assert np.abs(error).max() < 0.01


@pytest.mark.parametrize("ratio", [0.33, -0.3])
def test_a_small_card_before_a_plane_is_not_overlooked(ratio):
    shot = shot_of(*plane(camera(), ratio=0.3).surfaces, card(ratio, (250, 200), (370, 300)))
    full, quick = both(shot)
    assert "plane" not in quick.saved
    centres = shot.truth.calibration.lattice.centres()
    on_card = ((centres > (285, 235)) & (centres < (335, 265))).all(1)
    assert on_card.sum() >= 3
    assert np.abs(quick.patch_size[on_card] - ratio * 23.2).max() < 0.2
    assert agreement(full, quick) > 0.99


def test_depths_that_do_not_occur_are_not_tried(house):
    calibration = house.truth.calibration
    full = lfrender.analyze(house.flat, calibration, skip=False)
    quick = lfrender.analyze(house.flat, calibration, skip="ranges")
    assert set(quick.saved) == {"ranges"}
    assert agreement(full, quick) > 0.99


def test_blank_lenses_are_not_matched_and_the_rest_stays():
    shot = shot_of(*blank(camera(), ratio=0.2).surfaces, card(0.3, (200, 150), (420, 330)), noise=(4000, 5))
    full, quick = both(shot)
    assert quick.saved["blank"] > 0.6
    assert agreement(full, quick) > 0.99
    assert 0.05 < (quick.mode == 1).mean() < 0.4
    assert set(np.unique(quick.reason)) >= {0, 1}


def test_a_card_before_a_blank_wall_is_one_plane_and_two_depths_are_not():
    wall = blank(camera(), ratio=0.2).surfaces
    full, quick = both(shot_of(*wall, card(0.3, (150, 100), (450, 380)), noise=(4000, 5)))
    assert quick.saved["plane"] > 0.1
    assert agreement(full, quick) > 0.99
    for depth in (full, quick):
        known = depth.patch_size[depth.mode != 0]
        assert np.ptp(known) == 0
        assert abs(known[0] - 0.3 * 23.2) < 0.01
    full, quick = both(shot_of(*wall, card(0.3, (150, 100), (300, 380)), card(0.34, (320, 100), (470, 380))))
    assert "plane" not in quick.saved
    assert agreement(full, quick) > 0.99
    assert np.ptp(quick.patch_size[quick.mode != 0]) > 0.03 * 23.2


def test_texture_in_two_corners_is_found_when_the_rest_is_cut_off_or_not():
    one, two = card(0.3, (40, 40), (200, 160)), card(-0.3, (440, 320), (600, 440))
    for cards in ((one,), (one, two)):
        shot = shot_of(*blank(camera(), ratio=0.2).surfaces, *cards, noise=(4000, 5))
        full, quick = both(shot)
        assert quick.saved["blank"] > 0.6
        assert agreement(full, quick) > 0.99
        assert (full.reason == 1).mean() > 0.6
        # A lens on the edge of a card sees two depths, and may be given something between them.
        off = np.abs(quick.filled_patch_size - full.filled_patch_size)[full.mode != 0]
        assert (off < 0.05).mean() > 0.98
        assert off.max() < 0.03 * 23.2


def with_slopes(shot, strength):
    """A capture whose microimages all grow brighter to the right, by so much from the middle to the rim."""
    lattice = shot.truth.calibration.lattice
    y, x = np.mgrid[: shot.flat.shape[0], : shot.flat.shape[1]]
    points = np.stack([x, y], -1).reshape(-1, 2)
    straight = np.linalg.inv(lattice.basis)
    away = (points - lattice.centres()[0]) @ straight
    away = (away - np.rint(away)) @ lattice.basis
    light = 1 + strength * (away[:, 0] / lattice.radius).reshape(y.shape)
    return np.clip(np.rint(shot.flat * light[..., None]), 0, 255).astype(np.uint8)


def test_shading_that_all_lenses_share_does_not_pass_for_fine_texture_of_blank_ones():
    shot = shot_of(*blank(camera(), ratio=0.2).surfaces, card(0.3, (200, 150), (420, 330)), noise=(4000, 5))
    calibration = shot.truth.calibration
    quick = lfrender.analyze(with_slopes(shot, 0.03), calibration)
    assert quick.saved["blank"] > 0.6
    plain = lfrender.analyze(shot.flat, calibration)
    assert np.mean((quick.mode == 0) == (plain.mode == 0)) > 0.97


@pytest.mark.parametrize("strength", [0.01, 0.03])
def test_a_card_is_one_plane_whether_shading_hardly_matters_or_fakes_texture(strength):
    shot = shot_of(*blank(camera(), ratio=0.2).surfaces, card(0.3, (150, 100), (450, 380)), noise=(4000, 5))
    full, quick = both(replace(shot, flat=with_slopes(shot, strength)))
    assert quick.saved["plane"] > 0.1
    assert agreement(full, quick) > 0.99
    known = quick.patch_size[quick.mode != 0]
    assert np.ptp(known) == 0
    assert abs(known[0] - 0.3 * 23.2) < 0.01


def test_a_card_among_blank_lenses_is_found_without_taking_shading_from_all_of_them(monkeypatch):
    shot = shot_of(*blank(camera(), ratio=0.2).surfaces, card(0.3, (150, 100), (450, 380)), noise=(4000, 5))
    freed = []
    flatten = texture.flatten_shading

    def counted(gray, lattice, means, contrast, wanted, *others, **how):
        freed.append(wanted.mean())
        return flatten(gray, lattice, means, contrast, wanted, *others, **how)

    monkeypatch.setattr(texture, "flatten_shading", counted)
    quick = lfrender.analyze(shot.flat, shot.truth.calibration)
    assert quick.saved["plane"] > 0.1
    # All lenses with texture are two fifths of them.
    assert sum(freed) < 0.1


def test_lenses_without_texture_are_drawn_like_the_nearest_that_have_some():
    cards = card(0.3, (40, 40), (200, 160)), card(-0.3, (440, 320), (600, 440))
    shot = shot_of(*blank(camera(), ratio=0.2).surfaces, *cards, noise=(4000, 5))
    depth = lfrender.analyze(shot.flat, shot.truth.calibration)
    centres = shot.truth.calibration.lattice.centres()
    for corner, ratio in (((0, 0), 0.3), (SIZE, -0.3)):
        lens = np.argmin(np.linalg.norm(centres - np.array(corner), axis=1))
        assert depth.mode[lens] == 0
        assert abs(depth.filled_patch_size[lens] - ratio * 23.2) < 0.3


@pytest.mark.parametrize("gain", [0.15, 0.1])
def test_texture_as_fine_as_noise_is_not_taken_for_a_blank_scene(gain, house):
    faint = (100 + gain * (house.flat - 100.0)).round().astype(np.uint8)
    full, quick = both(replace(house, flat=faint))
    assert (full.mode != 0).mean() > 0.4
    assert agreement(full, quick) > 0.99


def test_thin_branches_are_found_where_few_lenses_tell_which_depths_occur():
    wide = Camera.design(size=(910, 690), pitch=20.3, lattice="hex", rotation=1.3)
    shot = simulate(SCENES["house"](wide), wide, samples=12, seed=4)
    faint = (100 + 0.1 * (shot.flat - 100.0)).round().astype(np.uint8)
    full, quick = both(replace(shot, flat=faint))
    assert 0.5 < (full.mode != 0).mean() < 0.95
    assert agreement(full, quick) > 0.99


def test_only_known_shortcuts_can_be_named():
    shot = one_plane()
    with pytest.raises(ValueError, match="blank, ranges, plane, still"):
        lfrender.analyze(shot.flat, shot.truth.calibration, skip="everything")


def test_a_region_of_interest_is_analysed_alone(house):
    calibration = house.truth.calibration
    roi = (150.0, 100.0, 330.0, 280.0)
    centres = calibration.lattice.centres()
    inside = ((centres >= roi[:2]) & (centres <= roi[2:])).all(1)
    full = lfrender.analyze(house.flat, calibration)
    part = lfrender.analyze(house.flat, calibration, roi=roi)
    assert (part.reason[~inside] == 4).all()
    assert (part.confidence[~inside] == 0).all()
    assert np.isnan(part.patch_size[~inside]).all()
    assert part.saved["roi"] == pytest.approx(1 - inside.mean())
    deep = inside & (part.mode != 0) & (full.mode != 0)
    assert deep.sum() > 0.8 * inside.sum()
    assert np.quantile(np.abs(full.patch_size - part.patch_size)[deep], 0.9) < 0.05
    at = centres[inside]
    assert np.quantile(np.abs(full.surface.at(at) - part.surface.at(at)), 0.9) < 0.1


@pytest.mark.parametrize(
    "roi", [(5, 5, 1, 9), (0, 0, np.nan, 9), (900, 900, 950, 950), (0, 0, 1, 1), (1, 2, 3), "abcd"]
)
def test_regions_without_sense_or_lenses_are_refused(house, roi):
    with pytest.raises(ValueError, match="roi"):
        lfrender.analyze(house.flat, house.truth.calibration, roi=roi)


def noisy(flat, seed):
    noise = np.random.default_rng(seed).normal(0, 2.0, flat.shape)
    return np.clip(np.rint(flat + noise), 0, 255).astype(np.uint8)


def test_a_still_frame_keeps_its_answer_through_noise(house):
    calibration = house.truth.calibration
    first, second = noisy(house.flat, 1), noisy(house.flat, 2)
    before = lfrender.analyze(first, calibration)
    after = lfrender.analyze(second, calibration, previous=(first, before))
    assert after.saved["still"] > 0.98
    same = (after.patch_size == before.patch_size) | (np.isnan(after.patch_size) & np.isnan(before.patch_size))
    assert same.mean() > 0.95


def test_a_motion_of_a_third_of_a_pixel_is_told_from_noise(house):
    from scipy.ndimage import shift

    calibration = house.truth.calibration
    moved = np.rint(shift(house.flat.astype(float), (0, 0.33, 0), order=1, mode="nearest")).astype(np.uint8)
    changed = [find_changed_lenses(noisy(house.flat, k), noisy(moved, k + 1), calibration) for k in range(1, 17, 2)]
    assert np.mean(changed) > 0.55
    assert find_changed_lenses(noisy(house.flat, 1), noisy(house.flat, 2), calibration).mean() < 0.003


def test_only_what_has_changed_is_analysed_again(house):
    calibration = house.truth.calibration
    lattice = calibration.lattice
    centres = lattice.centres()
    other = simulate(SCENES["plane"](house.camera, ratio=0.45), house.camera, samples=16, seed=4)
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


def test_an_earlier_frame_of_another_kind_is_refused(house):
    calibration = house.truth.calibration
    before = lfrender.analyze(house.flat, calibration, "fast")
    with pytest.raises(FlatError, match="float32"):
        lfrender.analyze(house.flat, calibration, "fast", previous=(house.flat / np.float32(255), before))
    with pytest.raises(ValueError, match="preset"):
        lfrender.analyze(house.flat, calibration, previous=(house.flat, before))
