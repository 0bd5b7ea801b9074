"""Depth of large flats by tiles of lenses: nearly the answers of one go, and how far they may differ."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import tifffile

import lfcal
import lfrender
from data_synth import SCENES, Camera, simulate


@functools.cache
def capture(scene, **arguments):
    camera = Camera.design(size=(330, 300), pitch=13.2, lattice="hex", rotation=1.3)
    return simulate(SCENES[scene](camera, **arguments), camera, samples=8, seed=2)


def in_both_ways(tmp_path, shot, tile):
    tifffile.imwrite(tmp_path / "flat.tif", shot.flat, photometric="rgb")
    camera = shot.truth.calibration
    with lfcal.open_flat(tmp_path / "flat.tif") as source:
        many = lfrender.analyze_large(source, camera, "fast", tile=tile)
    return lfrender.analyze(shot.flat, camera, "fast"), many, camera


@pytest.mark.parametrize("tile", [170, None])
def test_tiles_of_lenses_give_nearly_the_depth_of_one_go(tmp_path, tile):
    shot = capture("house")
    one, many, _ = in_both_ways(tmp_path, shot, tile)
    assert (one.mode == many.mode).mean() > 0.97
    both = (one.reason == 0) & (many.reason == 0)
    apart = np.abs(one.patch_size - many.patch_size)[both]
    assert np.median(apart) < 0.002
    assert np.mean(apart > 0.1) < 0.03
    assert (one.surface.first, one.surface.spacing) == (many.surface.first, many.surface.spacing)
    surfaces = np.abs(one.surface.patch_size - many.surface.patch_size)
    assert np.mean(surfaces > 0.1) < 0.05


def test_one_plane_is_seen_as_one_plane(tmp_path):
    one, many, _ = in_both_ways(tmp_path, capture("plane", ratio=0.32), 170)
    assert np.ptp(many.drawn) < 1e-4
    assert many.drawn.mean() == pytest.approx(one.drawn.mean(), abs=0.02)
    assert (one.mode == many.mode).mean() > 0.99


def test_the_surface_of_every_place_comes_from_the_tile_it_lies_in(tmp_path):
    """A tile whose surface is pasted beside its place would be off by the slope of the scene."""
    shot = capture("slope")
    one, many, camera = in_both_ways(tmp_path, shot, 170)
    places = camera.lattice.centres()
    apart = np.abs(one.surface.at(places) - many.surface.at(places))
    assert np.median(apart) < 0.01
