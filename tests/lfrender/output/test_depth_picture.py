"""Maps of depth maps: the right colour at the right lens."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from lfcal import Lattice
from lfrender.data.depth_map import MODE_COLOURS
from lfrender.output.depth_picture import lens_maps


def test_each_pixel_shows_the_mode_and_magnification_of_its_nearest_lens():
    lattice = Lattice((20.0, 20.0), [[40.0, 0.0], [0.0, 40.0]], (320, 240), 18.0)
    mode = np.array([1, -1, 0])[lattice.indices().sum(1) % 3]
    x, y = lattice.centres().T
    magnification = np.where(y < 40, np.nan, np.where(x < 160, 2.0, 10.0))
    depth = SimpleNamespace(
        mode=mode, magnification=magnification, confidence=np.where(x < 160, 0.1, 0.9)
    )
    maps = lens_maps(depth, lattice, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], (240, 320))
    for (x, y), code in zip(lattice.centres().astype(int), mode, strict=True):
        assert tuple(maps["modes"][y + 15, x - 15]) == MODE_COLOURS[code]
    low, high = (maps["magnification"][200, column].astype(int) for column in (100, 250))
    assert low[2] > low[0] and high[0] > high[2], "from blue to red"
    assert tuple(maps["magnification"][10, 100]) == MODE_COLOURS[0]
    assert maps["confidence"][200, 100].sum() < maps["confidence"][200, 250].sum(), (
        "from dark to light"
    )
