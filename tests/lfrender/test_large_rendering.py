"""Large flats drawn tile by tile: the same bits as in one go, files that appear whole, and runs that go on."""

from __future__ import annotations

import functools
import json
from dataclasses import replace

import numpy as np
import pytest
import tifffile

import lfcal
import lfrender
from data_synth import SCENES, Camera, simulate
from lfrender import large_rendering


@functools.cache
def capture():
    """A house behind branches on a small flat, its camera, one with a gain map lens by lens, and the depth."""
    camera = Camera.design(size=(230, 200), pitch=17.2, lattice="hex", rotation=1.3)
    shot = simulate(SCENES["house"](camera), camera, samples=6, seed=2)
    plain = shot.truth.calibration
    own = (1 + 0.2 * np.sin(np.arange(len(plain.lattice)))).astype(np.float32)
    own[7] = 0
    gain = replace(lfcal.calibrate(shot.white, kind="white").gain_map, own=own)
    return shot.flat, plain, replace(plain, gain_map=gain), lfrender.analyze(shot.flat, plain, "fast")


def drawn_in_tiles(tmp_path, flat, camera, tile, *, name="picture.tif", stored=None, **options):
    tifffile.imwrite(tmp_path / "flat.tif", flat, photometric="rgb" if flat.ndim == 3 else "minisblack", **stored or {})
    with lfcal.open_flat(tmp_path / "flat.tif") as source:
        return lfrender.render_large(source, tmp_path / name, camera, tile=tile, **options)


@pytest.mark.parametrize("tile", [23, 64, None])
@pytest.mark.parametrize("way", ["depth", "fixed", "blended", "small", "gain", "gain fixed", "mosaic", "float"])
def test_tiles_make_the_picture_of_one_go_bit_for_bit(tmp_path, way, tile):
    flat, plain, shaded, depth = capture()
    camera = shaded if way.startswith("gain") else plain
    options = {
        "fixed": {"patch_size": 6.5},
        "gain fixed": {"patch_size": 6.5},
        "blended": {"patch_size": -6.0, "blend": True, "scale": 9.3},
        "small": {"depth": depth, "scale": 3.0},
    }.get(way, {"depth": depth})
    if way == "mosaic":
        flat, camera = flat[:, :, 1].copy(), replace(camera, mosaic="GRBG")
    if way == "float":
        flat = (flat / 255).astype(np.float32)
    whole = lfrender.render(flat, camera, **options)
    made = drawn_in_tiles(tmp_path, flat, camera, tile, **options)
    picture = lfcal.read_flat(tmp_path / "picture.tif")
    assert picture.dtype == whole.image.dtype
    np.testing.assert_array_equal(picture, whole.image)
    np.testing.assert_array_equal(made.affine, whole.affine)
    assert made.valid == pytest.approx(whole.valid.mean())
    rows, columns = whole.image.shape[:2]
    assert made.tiles == (1 if tile is None else -(-rows // tile) * -(-columns // tile))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["flat.tif", "picture.tif"]
