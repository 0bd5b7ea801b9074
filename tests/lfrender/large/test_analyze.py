"""Depth of large flats by tiles of lenses: nearly that of the whole flat at once, and how far they
may differ.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
import tifffile

import lfcal
import lfrender
from data_synth import SCENES, Camera, simulate


@functools.cache
def capture(scene, size=(330, 300), pitch=13.2, **arguments):
    camera = Camera.design(size=size, pitch=pitch, lattice="hex", rotation=1.3)
    return simulate(SCENES[scene](camera, **arguments), camera, samples=8, seed=2)


def in_both_ways(tmp_path, shot, camera=None, tiles=4):
    """Depth of the whole flat at once and by tiles, and the camera."""
    tifffile.imwrite(tmp_path / "flat.tif", shot.flat, photometric="rgb")
    camera = camera or shot.truth.calibration
    counts = []
    # Tiles as small as their halo allows: 2 x 2 of these flats.
    options = {
        "progress": lambda _, count: counts.append(count),
        "memory": 1.0 if tiles > 1 else 6e8,
    }
    with lfcal.open_flat(tmp_path / "flat.tif") as source:
        many = lfrender.analyze_large(source, camera, "fast", **options)
    assert set(counts) <= {tiles}
    return lfrender.analyze(shot.flat, camera, "fast"), many, camera


@pytest.mark.parametrize("pitch, size", [(13.2, (330, 300)), (23.2, (521, 471))])
@pytest.mark.parametrize("tiles", [1, 4])
def test_depth_by_tiles_is_nearly_that_of_the_whole_flat(tmp_path, pitch, size, tiles):
    """Of the larger pitch, `fast` reduces 2 x 2 pixels to one; a row and a column are left over."""
    shot = capture("house", size, pitch)
    one, many, _ = in_both_ways(tmp_path, shot, tiles=tiles)
    assert many.pitch == one.pitch and many.image_size == size
    assert (one.mode == many.mode).mean() > 0.97
    both = (one.reason == 0) & (many.reason == 0)
    apart = np.abs(one.patch_size - many.patch_size)[both]
    assert np.median(apart) < 0.002
    assert np.mean(apart > 0.1) < 0.03
    assert (one.surface.first, one.surface.spacing) == (many.surface.first, many.surface.spacing)
    surfaces = np.abs(one.surface.patch_size - many.surface.patch_size)
    assert np.mean(surfaces > 0.1) < 0.05


def test_the_surface_of_every_place_comes_from_the_tile_it_lies_in(tmp_path):
    """A tile whose surface is pasted beside its place would be off by the slope of the scene."""
    shot = capture("slope")
    one, many, camera = in_both_ways(tmp_path, shot)
    places = camera.lattice.centres()
    apart = np.abs(one.surface.at(places) - many.surface.at(places))
    assert np.median(apart) < 0.01
