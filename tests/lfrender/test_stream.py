"""Flats as they come: their pictures are those of one call after the other."""

from __future__ import annotations

import numpy as np
import pytest

import lfrender
from lfcal import CalibrationError
from lfrender import stream


def _moving(house, count):
    """Noisy flats in which something moves across a still scene."""
    for number in range(count):
        noise = np.random.default_rng(number).integers(-2, 3, house.flat.shape)
        flat = np.clip(house.flat.astype(int) + noise, 0, 255).astype(np.uint8)
        x = 40 + 30 * number
        flat[50:150, x : x + 90] = flat[50:150, x : x + 90][::-1].copy()
        yield flat


@pytest.mark.parametrize("shared", [True, False])
def test_pictures_of_a_stream_are_those_of_calls_by_turns(house, monkeypatch, shared):
    camera, flats = house.truth.calibration, list(_moving(house, 5))
    monkeypatch.setattr(stream, "can_share", lambda size: shared)
    found = list(lfrender.render_stream(iter(flats), camera))
    assert len(found) == len(flats)
    depth = lfrender.analyze(flats[0], camera, "fast")
    picture = lfrender.render(flats[0], camera, depth)
    for number, (flat, (one, drawn)) in enumerate(zip(flats, found, strict=True)):
        if number:
            earlier = flats[number - 1], depth, picture
            depth = lfrender.analyze(flat, camera, "fast", previous=earlier[:2])
            picture = lfrender.render(flat, camera, depth, previous=earlier)
            assert one.saved["still"] > 0.2
        np.testing.assert_array_equal(one.patch_size, depth.patch_size)
        np.testing.assert_array_equal(one.surface.patch_size, depth.surface.patch_size)
        np.testing.assert_array_equal(drawn.image, picture.image)
        assert drawn.scale == picture.scale


def test_a_flat_of_another_size_ends_a_stream_after_the_pictures_before_it(house):
    flats = list(_moving(house, 3))
    coming = lfrender.render_stream([*flats[:2], flats[2][:-8], flats[2]], house.truth.calibration)
    assert [drawn.image.shape for _, drawn in (next(coming), next(coming))]
    with pytest.raises(CalibrationError, match="calibrate on this flat"):
        next(coming)
    assert list(coming) == []


def test_a_stream_without_flats_has_no_pictures_and_scale_is_kept(house):
    assert list(lfrender.render_stream([])) == []
    (_, first), (_, second) = lfrender.render_stream(_moving(house, 2), house.truth.calibration, scale=3.5)
    assert first.scale == second.scale == 3.5
