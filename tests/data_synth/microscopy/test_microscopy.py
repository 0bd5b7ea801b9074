"""Two simulations of one microscope, by rays and by waves, agree with geometry and with each
other."""

from __future__ import annotations

import numpy as np
import pytest

from data_synth.microscopy import Microscope, Specimen, propagate_flat, trace_flat

MICROSCOPE = Microscope(lenses=(11, 11), rotation=1.0)


def _centroid_of_lens(capture, column, row):
    """Offset x, y of the light from the centre of the lens `column`, `row` lenses from the middle
    one [px]."""
    centre = capture.calibration.lattice.points([[column, row]])[0]
    y, x = np.mgrid[: capture.flat.shape[0], : capture.flat.shape[1]]
    away = np.stack([x, y], -1) - centre
    near = np.hypot(away[..., 0], away[..., 1]) < MICROSCOPE.pupil_radius
    light = capture.flat[near].astype(float)
    return (away[near] * light[:, None]).sum(0) / light.sum()


def _expected_offset(depth, column):
    """Where the lens shows a bead at this depth above the middle one [px], by the sine
    condition."""
    aside = column * MICROSCOPE.pitch * MICROSCOPE.object_pixel
    sine = aside / np.hypot(aside, depth)
    flat_radius = MICROSCOPE.pupil_radius * MICROSCOPE.medium_index / MICROSCOPE.na
    return -np.sign(depth) * sine * flat_radius


@pytest.mark.parametrize("depth", [-4.0, 4.0])
def test_a_traced_bead_is_where_the_sine_condition_puts_it(depth):
    capture = trace_flat(Specimen.beads([[0, 0, depth]], 0.3), MICROSCOPE, samples=64)

    for column in (-3, 3):
        offset = _centroid_of_lens(capture, column, 0)
        turn = np.radians(MICROSCOPE.rotation)
        along = offset @ [np.cos(turn), np.sin(turn)]
        assert along == pytest.approx(_expected_offset(depth, column), abs=0.25)


@pytest.mark.parametrize("depth", [4.0, pytest.param(-4.0, marks=pytest.mark.nightly)])
def test_waves_put_a_point_where_rays_do(depth):
    specimen = Specimen.beads([[0.4, -0.3, depth]], 0.2)

    rays = trace_flat(specimen, MICROSCOPE, samples=64)
    waves = propagate_flat(specimen, MICROSCOPE)

    for column in (-2, 2):
        difference = _centroid_of_lens(rays, column, 1) - _centroid_of_lens(waves, column, 1)
        # Waves spread to the sides, and the rim of the microimage cuts them off.
        assert np.hypot(*difference) < 1.2


def test_white_images_are_even_within_the_aperture_and_dark_beyond_it():
    white = trace_flat(Specimen.beads([[0, 0, 3]], 0.3), MICROSCOPE, samples=16).white.astype(float)
    y, x = np.mgrid[: white.shape[0], : white.shape[1]]
    lattice = MICROSCOPE.lattice
    points = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    away = np.hypot(*(points - lattice.points(np.rint(lattice.to_index(points)))).T).reshape(
        white.shape
    )

    inside = white[away < MICROSCOPE.pupil_radius - 1]
    outside = white[away > MICROSCOPE.pupil_radius + 1]

    assert inside.std() < 0.01 * inside.mean()
    assert outside.max() == 0


def test_points_of_a_shell_fill_it_evenly_and_share_its_light():
    shell = Specimen.shell(5.0, 1.0, (1.0, 2.0, 3.0))
    places, light = shell.points(0.6, np.random.default_rng(0))
    away = np.linalg.norm(places - [1, 2, 3], axis=1)

    assert away.min() >= 4.5 and away.max() <= 5.5
    assert light.sum() == pytest.approx(4 / 3 * np.pi * (5.5**3 - 4.5**3))
    assert np.abs(places.mean(0) - [1, 2, 3]).max() < 0.05


def test_the_volume_of_a_bead_holds_its_light():
    axis = np.arange(-2, 2.01, 0.25)
    volume = Specimen.beads([[0.1, 0.2, -0.1]], 1.0).volume(axis, axis, axis)

    assert volume.sum() * 0.25**3 == pytest.approx(4 / 3 * np.pi, rel=0.02)


@pytest.mark.parametrize(("field", "value"), [("na", 1.4), ("lenses", (2, 9))])
def test_microscopes_that_cannot_be_are_refused(field, value):
    with pytest.raises(ValueError, match=field):
        Microscope(**{field: value})
