"""Limits of the depth analysis: image planes too near the microlenses, noise, and structures
thinner than a lens.
"""

import functools

import numpy as np
import pytest

import lfrender
from benchmarks import depth_sweep
from data_synth import Camera, Patch, Scene, simulate
from data_synth.scenes import plane
from lfcal import Calibration


@functools.cache
def plane_flat(ratio, pitch=23.2, size=(300, 260)):
    camera = Camera.design(size=size, pitch=pitch, rotation=1.3)
    return simulate(plane(camera, ratio=ratio), camera, samples=16, seed=2)


# Without any overlap a few lenses match by chance.
@pytest.mark.parametrize(
    ("ratio", "most"),
    [(-1.2, 0.08), (-0.95, 0.05), (-0.85, 0.05), (0.85, 0.05), (0.95, 0.05), (1.2, 0.08)],
)
def test_planes_beyond_three_quarters_of_a_pitch_are_unresolved(ratio, most):
    shot = plane_flat(ratio)
    depth = lfrender.analyze(shot.flat, shot.truth.calibration)
    assert (depth.mode != 0).mean() < most
    assert (depth.confidence > 0.5).mean() < most
    assert np.isin(depth.reason[depth.mode == 0], [1, 2, 3]).all()


@pytest.mark.parametrize("ratio", [-0.7, -0.6, 0.6, 0.7])
def test_planes_just_below_three_quarters_of_a_pitch_are_resolved(ratio):
    shot = plane_flat(ratio)
    depth = lfrender.analyze(shot.flat, shot.truth.calibration)
    assert (depth.mode == np.sign(ratio)).mean() > 0.95
    assert np.nanmedian(np.abs(depth.patch_size - shot.truth.patch_size)) < 0.2


def test_noise_from_40_to_12_db_degrades_the_depth_smoothly():
    shot = plane_flat(-0.3)
    errors = []
    for decibels in (40, 26, 18, 12):
        depth = lfrender.analyze(
            depth_sweep.noisy(shot.flat, decibels), shot.truth.calibration, skip=["blank", "ranges"]
        )
        assert (depth.mode == -1).mean() > 0.95
        errors.append(np.nanmedian(np.abs(depth.patch_size - shot.truth.patch_size)))
    assert errors[0] < 0.02
    assert errors[-1] < 0.15
    assert errors[-1] > errors[0]
    assert max(np.diff(errors)) < 0.1


@functools.cache
def rod_flat(across=0.12):
    """A textured rod a tenth of a pitch wide in the microimages, before a wall, upright in the
    middle.
    """
    camera = Camera.design(size=(480, 400), pitch=40.0, rotation=1.3)
    wall = plane(camera, ratio=-0.5, seed=3).surfaces
    # In scene coordinates the rod is wider by its magnification.
    half = 0.5 * across / 0.15 * camera.pitch
    depth = camera.depth_at(-0.15)
    corners = [(240 - half, -60), (240 + half, -60), (240 - half, 460)]
    corner, right, down = camera.place(corners, depth)
    texture = np.random.default_rng(1).uniform(0, 1, (200, 12, 3)).astype(np.float32)
    scene = Scene("rod", (*wall, Patch(corner, right - corner, down - corner, texture)))
    return simulate(scene, camera, samples=16, seed=2)


def test_a_rod_of_an_eighth_of_a_microimage_is_found_with_its_depth():
    shot = rod_flat()
    depth = lfrender.analyze(shot.flat, shot.truth.calibration)
    y = np.arange(80.0, 320.0, 4.0)
    on_rod = depth.surface.at(np.column_stack([np.full(len(y), 240.0), y]))
    beside = depth.surface.at(np.column_stack([np.full(len(y), 140.0), y]))
    assert (np.abs(on_rod + 0.15 * 40) < 2).mean() > 0.8
    assert (np.abs(beside + 0.5 * 40) < 2).mean() > 0.9


@functools.cache
def card_flat(width, wall=-0.55, card=-0.2):
    """A textured upright card `width` pitches wide in scene coordinates before a wall, at these `s
    / D`.
    """
    camera = Camera.design(size=(330, 280), pitch=23.2, rotation=1.3)
    behind = plane(camera, ratio=wall, seed=3).surfaces
    half = 0.5 * width * camera.pitch
    corner, right, down = camera.place(
        [(165 - half, -60), (165 + half, -60), (165 - half, 340)], camera.depth_at(card)
    )
    texture = (
        np.random.default_rng(1)
        .uniform(0, 1, (160, max(8, round(16 * width)), 3))
        .astype(np.float32)
    )
    scene = Scene("card", (*behind, Patch(corner, right - corner, down - corner, texture)))
    return simulate(scene, camera, samples=16, seed=2)


def mistaken(shot):
    """Share of the reference picture, a pitch off the border, where the depth is off by more than D
    / 20.
    """
    depth = lfrender.analyze(shot.flat, shot.truth.calibration)
    wanted = shot.truth.reference_patch_size
    affine = shot.truth.reference_affine
    v, u = np.mgrid[: wanted.shape[0], : wanted.shape[1]]
    points = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)]) @ affine.T
    wrong = np.abs(depth.surface.at(points).reshape(wanted.shape) - wanted) > 0.05 * depth.pitch
    near = np.abs(wanted - np.median(wanted)) > 0.1 * depth.pitch
    inner = np.s_[12:-12, 12:-12]
    return wrong[inner][near[inner]].mean(), wrong[inner][~near[inner]].mean()


def test_a_near_card_does_not_spread_over_the_wall_beside_it():
    lost, grown = mistaken(card_flat(4.0))
    assert lost < 0.05
    assert grown < 0.085


def test_a_binocular_rod_before_a_telescopic_wall_stays_whole():
    lost, grown = mistaken(card_flat(1.5, wall=0.2, card=-0.3))
    assert lost < 0.15
    assert grown < 0.05


@pytest.mark.parametrize("basis", [((23.2, 0.4), (11.25, 20.3)), ((22.9, 0.6), (-0.6, 22.9))])
def test_patch_sizes_from_minus_to_plus_three_quarters_of_a_pitch_keep_their_sign(
    drawn_flat, basis
):
    for s in (-17.0, -7.0, -0.6, 0.0, 0.6, 7.0, 17.0):
        gray, lattice, _, inner = drawn_flat(s if s else 1e-3, basis=basis)
        depth = lfrender.analyze(gray.image, Calibration(lattice))
        found = depth.patch_size[inner]
        resolved = depth.mode[inner] != 0
        assert np.isfinite(found[resolved]).all()
        assert np.isfinite(depth.filled_patch_size).all()
        if abs(s) > 0.5 and resolved.any():
            assert (np.sign(found[resolved]) == np.sign(s)).mean() > 0.99, s
            assert np.median(np.abs(found[resolved] - s)) < 0.1, s
