"""Volumes of simulated captures, by a model that shares nothing with the reconstruction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfrender
from benchmarks.volumes import axes, bead_places, focal_stack, locate, reconstruct, score
from data_synth.microscopy import Microscope, Specimen, trace_flat
from lfcal import Calibration, CalibrationError, Lattice


def test_shells_agree_with_the_truth_and_the_focal_stack_does_not(shells, shell_volume):
    truth = shells.specimen.volume(*axes(shell_volume, shells.microscope))

    assert score(shell_volume.data, truth)[0] > 0.85
    assert score(focal_stack(shells, shell_volume), truth)[0] < 0.65


def test_the_flat_is_explained_nearly_as_well_as_its_noise_allows(shell_volume):
    fit = shell_volume.fit

    assert 0.02 < fit.noise < 0.04  # 3,000 electrons in the brightest pixel
    assert fit.residual < 3.5 * fit.noise
    assert fit.steps <= 40


def test_without_the_sine_condition_depth_is_bent(shells, shell_volume):
    truth = shells.specimen.volume(*axes(shell_volume, shells.microscope))
    ends = tuple(shell_volume.slopes[[0, -1]])
    paraxial = lfrender.reconstruct_volume(
        shells.flat, shells.calibration, depth_range=ends, planes=len(shell_volume.slopes), steps=20
    )

    assert paraxial.unit == "px"
    assert score(paraxial.data, truth)[0] < score(shell_volume.data, truth)[0] - 0.1


def test_beads_are_found_within_a_tenth_of_a_pitch_and_one_plane():
    microscope = Microscope(lenses=(19, 19), rotation=1.5)
    places = bead_places(9, seed=2)
    capture = trace_flat(
        Specimen.beads(places, 0.4), microscope, samples=32, seed=2, electrons=3000
    )
    volume = reconstruct(capture, 11.0, 33)

    for place in places:
        found, _ = locate(volume, microscope, place)
        assert np.hypot(*(found - place)[:2]) < 0.1 * volume.pitch
        assert abs(found[2] - place[2]) < volume.spacing[0]


def test_the_native_plane_shows_no_blocks(shells):
    optics = lfrender.Microscope(**shells.microscope.optics())
    volume = lfrender.reconstruct_volume(
        shells.flat, shells.calibration, optics, depth_range=(-6, 6), planes=13, steps=15
    )
    native = volume.data[6]
    # Blocks have steps at the borders of lenses: second differences much above those of the planes
    # around.
    rough = np.abs(np.diff(native, 2, 1)).max() / native.max()

    assert abs(volume.slopes[6]) < 1e-9
    assert rough < 0.12


def test_a_start_from_the_volume_before_needs_fewer_steps(shells, shell_volume):
    optics = lfrender.Microscope(**shells.microscope.optics())
    again = lfrender.reconstruct_volume(
        shells.flat, shells.calibration, optics, depth_range=(-9, 9), planes=25, start=shell_volume
    )

    assert again.fit.steps < 0.6 * shell_volume.fit.steps
    assert again.fit.residual < 1.1 * shell_volume.fit.residual


def test_a_part_of_a_volume_is_that_of_the_whole(shells, shell_volume):
    optics = lfrender.Microscope(**shells.microscope.optics())
    part = lfrender.reconstruct_volume(
        shells.flat,
        shells.calibration,
        optics,
        depth_range=(-9, 9),
        planes=25,
        roi=(90, 80, 180, 150),
    )
    moved = np.subtract(part.origin, shell_volume.origin) / shell_volume.spacing
    z, y, x = np.rint(moved).astype(int)
    deep, high, wide = part.data.shape
    whole = shell_volume.data[z:deep, y : y + high, x : x + wide]

    assert moved == pytest.approx([z, y, x], abs=1e-6)
    assert high < shell_volume.data.shape[1] and wide < shell_volume.data.shape[2]
    assert np.corrcoef(part.data.ravel(), whole.ravel())[0, 1] > 0.99


def test_results_do_not_depend_on_the_number_of_threads(shells):
    import numba

    options = {"depth_range": (-8.0, 8.0), "planes": 5, "steps": 3}
    one = []
    several = numba.get_num_threads()
    for threads in (1, several):
        numba.set_num_threads(threads)
        one.append(lfrender.reconstruct_volume(shells.flat, shells.calibration, **options).data)
    numba.set_num_threads(several)

    assert np.array_equal(*one)


def test_progress_is_told_after_each_step(shells):
    told = []
    lfrender.reconstruct_volume(
        shells.flat,
        shells.calibration,
        depth_range=(-8, 8),
        planes=3,
        steps=2,
        progress=lambda *step: told.append(step),
    )

    assert told == [(1, 2), (2, 2)]


def test_a_specimen_that_reaches_beyond_the_range_is_noticed(shells):
    optics = lfrender.Microscope(**shells.microscope.optics())
    cut = lfrender.reconstruct_volume(
        shells.flat, shells.calibration, optics, depth_range=(-1.5, 3), planes=9, steps=15
    )

    assert any("reach beyond the range" in warning for warning in cut.warnings)


def test_missing_optics_are_said(shells):
    volume = lfrender.reconstruct_volume(shells.flat, shells.calibration, planes=3, steps=1)

    assert volume.unit == "px"
    assert any("in pixels of the flat" in warning for warning in volume.warnings)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"depth_range": (-0.3, 0.3)}, "native plane"),
        ({"depth_range": (5, -5)}, "depth_range"),
        ({"depth_range": (-900, 900)}, "four microlenses"),
        ({"planes": 1}, "planes"),
        ({"steps": 0}, "steps"),
        ({"voxels": 1.5}, "voxels"),
    ],
)
def test_bad_arguments_are_named(shells, options, message):
    with pytest.raises(ValueError, match=message):
        lfrender.reconstruct_volume(shells.flat, shells.calibration, **options)


def test_a_start_on_another_grid_is_refused(shells, shell_volume):
    with pytest.raises(ValueError, match="start must be"):
        lfrender.reconstruct_volume(shells.flat, shells.calibration, start=shell_volume)


def test_a_camera_of_another_size_and_a_dark_flat_are_refused(shells):
    other = Calibration(Lattice((5, 5), [[10, 0], [0, 10]], (40, 30), 4.5))
    with pytest.raises(CalibrationError, match="images of 40 x 30"):
        lfrender.reconstruct_volume(shells.flat, other)
    with pytest.raises(ValueError, match="dark"):
        lfrender.reconstruct_volume(np.zeros_like(shells.flat), shells.calibration)


def test_colours_are_averaged(shells):
    grey = shells.flat
    colours = np.stack([grey // 2, grey, grey // 2 + grey], -1).clip(0, 65535).astype(np.uint16)
    options = {"depth_range": (-8.0, 8.0), "planes": 3, "steps": 1}
    same = np.repeat(grey[:, :, None], 3, 2)

    one = lfrender.reconstruct_volume(grey, shells.calibration, **options)
    other = lfrender.reconstruct_volume(same, shells.calibration, **options)

    assert other.data == pytest.approx(one.data, rel=1e-4, abs=1e-6)
    assert (
        lfrender.reconstruct_volume(colours, shells.calibration, **options).data.shape
        == one.data.shape
    )


def test_a_camera_without_light_is_said(shells):
    bare = replace(shells.calibration, vignetting=None)
    volume = lfrender.reconstruct_volume(shells.flat, bare, depth_range=(-8, 8), planes=3, steps=1)

    assert any("white image" in warning for warning in volume.warnings)
