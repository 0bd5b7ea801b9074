"""The fingerprint of flats in depth maps."""

from __future__ import annotations

import numpy as np

from lfcal import Calibration, Lattice
from lfrender import analyze
from lfrender.data.depth_map import DepthMap

_CAMERA = Calibration(Lattice([10, 10], [[20, 0], [0, 20]], (200, 160), 9))


def _flat(seed):
    return np.random.default_rng(seed).integers(0, 255, (160, 200, 3)).astype(np.uint8)


def test_depth_file_knows_its_flat_in_other_types_and_no_other_flat(tmp_path):
    flat = _flat(1)
    analyze(flat, _CAMERA, "fast").save(tmp_path / "depth.npz")
    depth = DepthMap.load(tmp_path / "depth.npz")
    assert depth.is_of(flat)
    assert depth.is_of(flat.astype(np.uint16) * 257)
    assert depth.is_of(flat / np.float32(255))
    assert not depth.is_of(_flat(2))
    assert not depth.is_of(flat[:, ::-1])
