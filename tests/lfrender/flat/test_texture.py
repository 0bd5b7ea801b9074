"""Statistics and texture of microimages."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.ndimage import correlate

from lfcal import Lattice
from lfrender.flat.gray_flat import GrayFlat
from lfrender.flat.texture import find_texture, measure_statistics

LATTICE = Lattice((100.3, 80.7), ((30.0, 0.0), (15.0, 26.0)), (210, 170), 14.5)


def made(texture):
    """Grey microimages with `texture(distance from the centre, noise)` added."""
    y, x = np.mgrid[:170, :210]
    index = LATTICE.to_index(np.stack([x, y], -1).reshape(-1, 2))
    delta = (index - np.rint(index)) @ LATTICE.basis
    grain = np.random.default_rng(1).standard_normal(x.size)
    image = 0.5 + texture(np.hypot(*delta.T), grain)
    return GrayFlat(
        image.reshape(x.shape).astype(np.float32), LATTICE.centres().astype(np.float32), 13.5, 30.0
    )


def test_statistics_are_those_of_the_pixels_in_the_circle():
    gray = made(lambda r, grain: 0.1 * grain)
    statistics = measure_statistics(gray)
    lens = int(np.argmin(np.abs(gray.centres - (100, 80)).sum(1)))
    y, x = np.mgrid[:170, :210]
    distance = np.hypot(x - gray.centres[lens, 0], y - gray.centres[lens, 1])
    for name, radius in (("contrast", 13.5), ("central_contrast", 10.8)):
        np.testing.assert_allclose(
            getattr(statistics, name)[lens], gray.image[distance <= radius].std(), rtol=1e-4
        )
    np.testing.assert_allclose(
        statistics.mean[lens], gray.image[distance <= 13.5].mean(), rtol=1e-5
    )
    np.testing.assert_allclose(np.median(statistics.roughness), 0.1, rtol=0.05)


def test_texture_at_the_rim_alone_is_no_texture():
    inner = np.all((LATTICE.centres() > 15) & (LATTICE.centres() < (194, 154)), axis=1)
    at_the_rim = made(lambda r, grain: np.where(r > 11.5, 0.1 * np.sign(grain), 0))
    rim = find_texture(at_the_rim, LATTICE, measure_statistics(at_the_rim))
    assert not (rim.clear | rim.faint)[inner].any()
    everywhere = made(lambda r, grain: 0.1 * np.sign(grain))
    whole = find_texture(everywhere, LATTICE, measure_statistics(everywhere))
    assert whole.flat.image.shape == (170, 210)
    assert (whole.clear | whole.faint)[inner].all()


@pytest.mark.parametrize("step", [1, 2, 3, 5])
def test_statistics_of_some_rows_are_those_of_their_pixels(step):
    image, radius, (cx, cy) = (
        np.random.default_rng(3).random((60, 70)).astype(np.float32),
        17.5,
        (33.3, 29.8),
    )
    found = measure_statistics(
        GrayFlat(image, np.array([[cx, cy]], np.float32), radius, 2 * radius), row_step=step
    )
    y, x = np.mgrid[:60, :70]
    away = (x - cx) ** 2 + (y - cy) ** 2
    rows = (y - int(np.ceil(cy - radius))) % step == 0
    inside = rows & (away <= radius**2)
    middle = rows & (away <= (0.36 * 2 * radius) ** 2)
    mask = np.outer([1, -2, 1], [1, -2, 1])
    bends = correlate(image.astype(float), mask)[inside]
    assert found.mean[0] == pytest.approx(image[inside].mean(), rel=1e-5)
    assert found.contrast[0] == pytest.approx(image[inside].std(), rel=1e-4)
    assert found.central_contrast[0] == pytest.approx(image[middle].std(), rel=1e-4)
    assert found.roughness[0] == pytest.approx(np.sqrt((bends**2).mean() / 36), rel=1e-4)


_STATISTICS_BITS = """
import numpy as np
import pytest
from scipy.ndimage import correlate
from lfrender.flat.gray_flat import GrayFlat
from lfrender.flat.texture import measure_statistics
rng = np.random.default_rng(0)
image = rng.random((300, 400), np.float32)
centres = (rng.random((200, 2)) * (400, 300)).astype(np.float32)
for radius in (3.2, 11.4, 17.5):
    for step in (1, 2):
        found = measure_statistics(GrayFlat(image, centres, radius, 2 * radius), row_step=step)
        names = ("mean", "contrast", "central_contrast", "roughness")
        print(*(getattr(found, name).tobytes().hex() for name in names))
"""


def test_statistics_have_the_same_bits_from_a_compiled_and_from_a_loaded_kernel(tmp_path):
    # This fails without forceinline.
    cold, warm = (
        subprocess.run(
            [sys.executable, "-c", _STATISTICS_BITS],
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            check=True,
            timeout=300,
        ).stdout
        for _ in "ab"
    )
    assert len(cold) > 10_000
    assert cold == warm
