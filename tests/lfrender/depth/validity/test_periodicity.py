"""Periodic textures, found by autocorrelation of the scene."""

import numpy as np
import pytest

import lfrender
from benchmarks.stress.outcome import depth_of_plane
from benchmarks.stress.plane_flats import PlaneFlat
from lfrender.depth.validity.periodicity import autocorrelation, find_periodic_texture, is_periodic


def _wave(period, side=61):
    y, x = np.mgrid[:side, :side]
    return np.sin(2 * np.pi * x / period) + np.sin(2 * np.pi * y / period)


def test_the_autocorrelation_of_a_wave_peaks_at_its_period():
    seen = np.ones((61, 61), bool)
    seen[40:, :20] = False
    found = autocorrelation(5 + _wave(12.0), seen, 20)
    assert found.shape == (41, 41)
    assert found[20, 20] == pytest.approx(1)
    assert found[20, 32] > 0.99 and found[32, 20] > 0.99
    assert found[26, 26] < -0.95
    assert is_periodic(found, 10.0) == (True, True)
    # Less than three microimages are too few.
    assert is_periodic(found, 2.0) == (False, False)


def test_lags_of_little_overlap_or_flat_overlap_do_not_count():
    seen = np.zeros((61, 61), bool)
    seen[:, :15] = seen[:, 46:] = True
    picture = np.random.default_rng(0).standard_normal((61, 61))
    assert autocorrelation(picture, seen, 25)[25, 45] == -1
    picture[:, 46:] = 0
    assert autocorrelation(picture, np.ones((61, 61), bool), 50)[50, 90] < 0.1


def test_random_texture_is_not_periodic():
    picture = np.random.default_rng(1).standard_normal((61, 61))
    assert is_periodic(autocorrelation(picture, np.ones((61, 61), bool), 20), 10.0) == (False, False)


# Wrong depths within reach match as well as the right one beyond it.
@pytest.mark.parametrize(
    "plane",
    [
        PlaneFlat(1.0, cell="square", pitch=9.4, degrees=0.0, size=(174, 173), contrast=0.15, period=0.86, fill=0.93),
        PlaneFlat(-1.0, cell="sheared", pitch=13.4, degrees=1.0, size=(245, 148), period=0.73, fill=0.99),
        PlaneFlat(2.4, cell="sheared", pitch=12.7, degrees=9.0, size=(139, 77), period=0.52),
    ],
)
def test_waves_beyond_reach_are_not_taken_for_planes_nearer_by(plane):
    found = depth_of_plane(plane)
    assert found.off == 0
    assert found.answered < 0.1


@pytest.mark.parametrize("ratio", [-0.3, 0.15, 0.5])
def test_planes_of_rich_texture_are_not_periodic(ratio):
    plane = PlaneFlat(ratio, pitch=14.0, size=(260, 200))
    depth = lfrender.analyze(plane.flat(), plane.calibration)
    assert (depth.mode != 0).mean() > 0.95
    assert np.median(depth.confidence) > 0.9


def test_a_wave_on_half_of_a_flat_is_found_on_that_half():
    left = PlaneFlat(-0.3, pitch=12.0, degrees=0.0, size=(640, 160), cell="square")
    right = PlaneFlat(-0.3, pitch=12.0, degrees=0.0, size=(640, 160), cell="square", period=0.9)
    flat = np.where(np.arange(640) < 320, left.flat(), right.flat()).astype(np.float32) / 65535
    lattice = left.lattice
    gray = lfrender.flat.gray_flat.make_gray_flat(flat[..., None], left.calibration)
    sizes = np.full(len(lattice), -0.3 * 12.0)
    again, _ = find_periodic_texture(gray, lattice.indices(), sizes, np.ones(len(lattice), bool))
    x = lattice.centres()[:, 0]
    assert again[(x > 400) & (x < 560)].mean() > 0.9
    assert again[x < 300].mean() < 0.1


def test_a_wave_on_half_of_a_plane_is_found_with_shortcuts():
    size = (900, 420)
    rich = PlaneFlat(-0.3, pitch=14.0, degrees=0.0, size=size, cell="square")
    wave = PlaneFlat(-0.3, pitch=14.0, degrees=0.0, size=size, cell="square", period=0.9)
    flat = np.where(np.arange(900) < 450, rich.flat(), wave.flat()).astype(np.uint16)
    depth = lfrender.analyze(flat, rich.calibration)
    x = rich.lattice.centres()[:, 0]
    # Only around the parts that are drawn; the exhaustive search leaves all of that half unresolved.
    assert (depth.mode[x > 500] == 0).mean() > 0.5
    assert (depth.mode[x < 400] != 0).mean() > 0.9
