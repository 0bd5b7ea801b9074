"""The forward model and its adjoint."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal import Calibration, Lattice
from lfrender.volume.footprint import blur_planes
from lfrender.volume.grid import VoxelGrid
from lfrender.volume.microscope import Microscope
from lfrender.volume.pixels import choose_pixels

LATTICES = {
    "square, turned": ([[13.1, 0.9], [-0.9, 13.1]], 6.2),
    "hexagonal": ([[12.4, 0.0], [6.2, 10.74]], 5.9),
    "rectangular": ([[12.0, 0.0], [0.0, 14.3]], 5.8),
}


def _projector(basis, radius, microscope, slopes):
    lattice = Lattice((61.3, 52.8), basis, (140, 120), radius)
    camera = Calibration(lattice)
    scale = microscope.scale(radius, lattice.pitch)
    pixels = choose_pixels(
        np.ones((120, 140), np.float32), camera, scale.flat_radius, scale.pupil_radius
    )
    grid = VoxelGrid.over(lattice, np.array(slopes), 7, pixels.reach)
    return grid.projector(pixels, lattice, scale)


@pytest.mark.parametrize("name", LATTICES)
@pytest.mark.parametrize(
    "microscope", [Microscope(), Microscope(na=1.1)], ids=["paraxial", "sine law"]
)
def test_the_adjoint_is_exact(name, microscope):
    projector = _projector(*LATTICES[name], microscope, [-5.3, -0.4, 0.0, 2.7])
    rng = np.random.default_rng(1)
    volume = rng.random((4, *projector.shape)).astype(np.float32)
    values = rng.random(len(projector.rays.centre_x)).astype(np.float32)

    seen = np.vdot(projector.forward(volume).astype(float), values.astype(float))
    spread = np.vdot(volume.astype(float), projector.adjoint(values).astype(float))

    assert seen == pytest.approx(spread, rel=1e-6)


@pytest.mark.parametrize("boxes", [(1.7,), (7.1,), (40.2,), (2.6, 7.1, 4.3)])
def test_the_footprint_is_its_own_adjoint(boxes):
    rng = np.random.default_rng(2)
    one, other = rng.random((2, 1, 29, 37)).astype(np.float32)
    if len(boxes) > 1:
        # Boxes that cut each other off at the border do not commute.
        one, other = (np.pad(plane, ((0, 0), (9, 9), (9, 9))) for plane in (one, other))
    widths = np.array([boxes])
    blurred_one, blurred_other = one.copy(), other.copy()
    blur_planes(blurred_one, widths)
    blur_planes(blurred_other, widths)

    left = np.vdot(blurred_one.astype(float), other.astype(float))
    right = np.vdot(one.astype(float), blurred_other.astype(float))

    assert left == pytest.approx(right, rel=1e-6)


def test_multiplying_a_volume_is_multiplying_by_the_adjoint():
    projector = _projector(*LATTICES["hexagonal"], Microscope(), [-2.3, 0.0, 4.1])
    rng = np.random.default_rng(3)
    values = rng.random(len(projector.rays.centre_x)).astype(np.float32)
    volume = rng.random((3, *projector.shape)).astype(np.float32)
    norm = projector.adjoint(np.ones_like(values))
    seen = norm > 0
    share = projector.adjoint(values) / np.where(seen, norm, 1)
    expected = np.where(seen, volume * share, 0)

    projector.multiply(volume, values, norm)

    np.testing.assert_allclose(volume, expected, rtol=1e-5, atol=1e-7)


def test_an_even_volume_is_seen_evenly():
    projector = _projector(*LATTICES["square, turned"], Microscope(), [-3.0, 0.0, 3.0])
    volume = np.ones((3, *projector.shape), np.float32)

    seen = projector.forward(volume)
    inner = np.abs(projector.rays.centre_x - projector.shape[1] / 2) < projector.shape[1] / 6

    assert seen[inner] == pytest.approx(3.0, rel=1e-4)


def test_a_point_above_a_lens_is_seen_by_its_neighbours_where_the_slope_puts_it():
    projector = _projector(*LATTICES["rectangular"], Microscope(), [4.0])
    rays = projector.rays
    row, column = (n // 2 for n in projector.shape)
    volume = np.zeros((1, *projector.shape), np.float32)
    volume[0, row, column] = 1

    light = projector.forward(volume).astype(float)
    x = rays.centre_x + 4.0 * rays.angle_x
    y = rays.centre_y + 4.0 * rays.angle_y

    assert (light * x).sum() / light.sum() == pytest.approx(column, abs=0.2)
    assert (light * y).sum() / light.sum() == pytest.approx(row, abs=0.2)


def test_boxes_of_any_width_keep_the_sum_and_have_the_variance_of_a_box():
    for width in (1.0, 1.7, 3.0, 8.4):
        plane = np.zeros((1, 41, 43), np.float32)
        plane[0, 20, 21] = 1
        blur_planes(plane, np.array([[width]]))
        across = plane[0].sum(0)
        down = plane[0].sum(1)

        assert plane.sum() == pytest.approx(1, rel=1e-5)
        # A box that is resampled to voxels is convolved with one of a voxel.
        expected = 0.0 if width <= 1 else (width**2 + 1) / 12
        for profile, middle in ((across, 21), (down, 20)):
            variance = (profile * (np.arange(len(profile)) - middle) ** 2).sum()
            assert variance == pytest.approx(expected, rel=0.35, abs=1e-6)


def test_cost_grows_in_proportion_to_pixels_and_planes():
    short = _projector(*LATTICES["hexagonal"], Microscope(), np.linspace(-3, 3, 5))
    long = _projector(*LATTICES["hexagonal"], Microscope(), np.linspace(-3, 3, 10))

    assert short.rays.centre_x.shape == long.rays.centre_x.shape
    # Nothing is stored but rays, slopes and widths: no matrix.
    assert sum(array.nbytes for array in long.rays) == 4 * 4 * len(long.rays.centre_x)
