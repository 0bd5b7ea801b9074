"""Periodic textures, found by autocorrelation of the scene."""

import numpy as np
import pytest

import lfrender
from benchmarks.stress.outcome import depth_of_plane
from benchmarks.stress.plane_flats import PlaneFlat
from lfrender.depth.validity.periodicity import find_periodic_texture


# Wrong depths within reach match as well as the right one beyond it.
@pytest.mark.parametrize(
    "plane",
    [
        PlaneFlat(
            1.0,
            cell="square",
            pitch=9.4,
            degrees=0.0,
            size=(174, 173),
            contrast=0.15,
            period=0.86,
            fill=0.93,
        ),
        PlaneFlat(
            -1.0, cell="sheared", pitch=13.4, degrees=1.0, size=(245, 148), period=0.73, fill=0.99
        ),
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
    # Only around the parts that are drawn; the exhaustive search leaves all of that half
    # unresolved.
    assert (depth.mode[x > 500] == 0).mean() > 0.5
    assert (depth.mode[x < 400] != 0).mean() > 0.9
