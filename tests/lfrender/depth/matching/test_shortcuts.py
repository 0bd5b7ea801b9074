"""Shortcuts of the analysis leave work out, but do not change the result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfrender
from data_synth.scenes import blank


def test_shifts_near_no_sampled_depth_are_skipped_without_changing_the_result(scenes, house):
    calibration = house.truth.calibration
    full = lfrender.analyze(house.flat, calibration, skip=False)
    quick = lfrender.analyze(house.flat, calibration, skip="ranges")
    assert set(quick.saved) == {"ranges"}
    assert scenes.agreement(full, quick) > 0.99


def test_blank_lenses_are_skipped_without_changing_others_and_shading_is_no_fine_texture(
    scenes,
):
    shot = scenes.shot_of(
        *blank(scenes.camera(), ratio=0.2).surfaces,
        scenes.card(0.3, (200, 150), (420, 330)),
        noise=(4000, 5),
        samples=32,
    )
    full, quick = scenes.both(shot)
    assert quick.saved["blank"] > 0.6
    assert scenes.agreement(full, quick) > 0.99
    assert 0.05 < (quick.mode == 1).mean() < 0.4
    assert set(np.unique(quick.reason)) >= {0, 1}
    shaded = lfrender.analyze(with_slopes(shot, 0.03), shot.truth.calibration)
    assert shaded.saved["blank"] > 0.6
    assert np.mean((shaded.mode == 0) == (quick.mode == 0)) > 0.97


def test_a_card_before_a_blank_wall_is_one_plane_and_two_depths_are_not(scenes):
    wall = blank(scenes.camera(), ratio=0.2).surfaces
    full, quick = scenes.both(
        scenes.shot_of(*wall, scenes.card(0.3, (150, 100), (450, 380)), noise=(4000, 5))
    )
    assert scenes.agreement(full, quick) > 0.99
    for depth in (full, quick):
        known = depth.patch_size[depth.mode != 0]
        # A lens at the edge of the card sees little of it.
        assert np.quantile(np.abs(known - 0.3 * 23.2), 0.9) < 0.02
    full, quick = scenes.both(
        scenes.shot_of(
            *wall,
            scenes.card(0.3, (150, 100), (300, 380)),
            scenes.card(0.34, (320, 100), (470, 380)),
        )
    )
    assert scenes.agreement(full, quick) > 0.99
    assert np.ptp(quick.patch_size[quick.mode != 0]) > 0.03 * 23.2


def test_texture_in_two_corners_of_a_blank_scene_is_found_and_fills_the_rest(scenes):
    cards = scenes.card(0.3, (40, 40), (200, 160)), scenes.card(-0.3, (440, 320), (600, 440))
    shot = scenes.shot_of(*blank(scenes.camera(), ratio=0.2).surfaces, *cards, noise=(4000, 5))
    full, quick = scenes.both(shot)
    assert quick.saved["blank"] > 0.6
    assert scenes.agreement(full, quick) > 0.99
    assert (full.reason == 1).mean() > 0.6
    # A lens at the edge of a card sees two depths and may get one between them.
    off = np.abs(quick.filled_patch_size - full.filled_patch_size)[full.mode != 0]
    assert (off < 0.05).mean() > 0.98
    assert off.max() < 0.03 * 23.2
    centres = shot.truth.calibration.lattice.centres()
    for corner, ratio in (((0, 0), 0.3), (scenes.size, -0.3)):
        lens = np.argmin(np.linalg.norm(centres - np.array(corner), axis=1))
        assert quick.mode[lens] == 0
        assert abs(quick.filled_patch_size[lens] - ratio * 23.2) < 0.3


def with_slopes(shot, strength):
    """A capture whose microimages all grow brighter to the right, by so much from the middle to the
    rim.
    """
    lattice = shot.truth.calibration.lattice
    y, x = np.mgrid[: shot.flat.shape[0], : shot.flat.shape[1]]
    points = np.stack([x, y], -1).reshape(-1, 2)
    straight = np.linalg.inv(lattice.basis)
    away = (points - lattice.centres()[0]) @ straight
    away = (away - np.rint(away)) @ lattice.basis
    light = 1 + strength * (away[:, 0] / lattice.radius).reshape(y.shape)
    return np.clip(np.rint(shot.flat * light[..., None]), 0, 255).astype(np.uint8)


def test_texture_of_the_contrast_of_noise_is_not_taken_for_a_blank_scene(scenes, house):
    faint = (100 + 0.1 * (house.flat - 100.0)).round().astype(np.uint8)
    full, quick = scenes.both(replace(house, flat=faint))
    assert (full.mode != 0).mean() > 0.4
    assert scenes.agreement(full, quick) > 0.99


def test_only_known_shortcuts_can_be_named(house):
    with pytest.raises(ValueError, match="blank, ranges, still"):
        lfrender.analyze(house.flat, house.truth.calibration, skip="everything")
