"""Depth edges on the pixels of the flat."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

import lfrender
from data_synth import SCENES, Camera, simulate
from lfrender.depth.edges.locate_edges import FINER, locate_edges, refine_grid
from lfrender.depth.pipeline import prepare_flat
from lfrender.flat.lens_graph import nearest_lens


@pytest.fixture(scope="module")
def house_in_front():
    """Branches before a house: flat, camera, depth without the edges, the true surface, the grey
    flat, its lattice.
    """
    camera = Camera.design(size=(420, 340), pitch=20.0)
    shot = simulate(SCENES["house"](camera), camera, samples=16, seed=9)
    calibration = shot.truth.calibration
    depth = lfrender.analyze(shot.flat, calibration, edges=False)
    size = shot.truth.reference_patch_size
    nearest = distance_transform_edt(
        ~np.isfinite(size), return_distances=False, return_indices=True
    )
    affine = shot.truth.reference_affine
    true = lfrender.data.surface.Surface(
        np.ascontiguousarray(size[tuple(nearest)], np.float32),
        (affine[0, 2], affine[1, 2]),
        affine[0, 0],
    )
    gray, lattice, _ = prepare_flat(shot.flat, calibration, "balanced")
    return shot.flat, calibration, depth, true, gray, lattice


def test_fewer_places_beside_branches_have_the_depth_of_the_other_surface(house_in_front):
    _, _, depth, true, gray, lattice = house_in_front
    after = locate_edges(gray, lattice, depth)

    def wrong(found):
        surface = found.surface
        rows, columns = surface.patch_size.shape
        v, u = np.mgrid[:rows, :columns]
        points = np.stack([u, v], -1).reshape(-1, 2) * surface.spacing + surface.first
        apart = surface.patch_size - true.at(points).reshape(rows, columns)
        return float((np.abs(apart) > 0.05 * depth.pitch).mean())

    assert wrong(after) < 0.6 * wrong(depth)


def test_no_region_smaller_than_a_tenth_of_a_square_pitch_differs_from_all_around(house_in_front):
    _, _, depth, _, gray, lattice = house_in_front
    values = depth.surface.patch_size.copy()
    values[40:42, 40:42] = -0.3 * lattice.pitch
    spotted = replace(depth, surface=replace(depth.surface, patch_size=values))
    after = locate_edges(gray, lattice, spotted).surface
    apart = 0.08 * lattice.pitch
    levels = np.rint(after.patch_size * (8 / apart)).astype(np.int16)
    before = levels.copy()
    cv2.filterSpeckles(levels, -(2**15), int(0.1 * (lattice.pitch / after.spacing) ** 2), 8)
    assert np.array_equal(levels, before)
    assert np.isfinite(after.patch_size).all()


def test_its_grid_is_finer_about_the_same_places(house_in_front):
    _, _, depth, _, gray, lattice = house_in_front
    after = locate_edges(gray, lattice, depth).surface
    before = depth.surface
    finer = len(after.patch_size) // len(before.patch_size)
    assert finer == round(before.spacing / after.spacing) == FINER
    middle = after.first[0] + 0.5 * (finer - 1) * after.spacing
    assert middle == pytest.approx(before.first[0])


def test_analyze_ends_with_it_where_asked_for(house_in_front):
    flat, calibration, depth, _, gray, lattice = house_in_front
    found = lfrender.analyze(flat, calibration, edges=True)
    assert np.array_equal(
        found.surface.patch_size, locate_edges(gray, lattice, depth).surface.patch_size
    )
    assert np.array_equal(found.patch_size, depth.patch_size, equal_nan=True)


def test_a_surface_without_edges_is_left_alone(house_in_front):
    _, _, depth, _, gray, lattice = house_in_front
    even = replace(
        depth,
        surface=replace(depth.surface, patch_size=np.full_like(depth.surface.patch_size, 6.0)),
    )
    assert locate_edges(gray, lattice, even) is even


def test_a_place_that_hardly_another_lens_shows_keeps_its_depth(house_in_front):
    _, _, depth, _, gray, lattice = house_in_front
    values = np.full_like(depth.surface.patch_size, 0.66 * lattice.pitch)
    values[:, values.shape[1] // 2 :] = 6.0
    near = replace(depth, surface=replace(depth.surface, patch_size=values))
    after = locate_edges(gray, lattice, near).surface.patch_size
    assert (after[:, : after.shape[1] // 2 - 4] > 0.6 * lattice.pitch).all()


def test_lenses_that_match_at_no_depth_leave_the_surface_as_it_is(house_in_front):
    _, _, depth, _, gray, lattice = house_in_front
    values = np.full_like(depth.surface.patch_size, 9.0)
    values[:, values.shape[1] // 2 :] = 5.0
    jump = replace(depth, surface=replace(depth.surface, patch_size=values))
    # On the microlenses each lens shows one place of the scene.
    v, u = np.indices(gray.image.shape)
    lens = nearest_lens(lattice.centres(), np.stack([u, v], -1).reshape(-1, 2).astype(float))
    random = np.random.default_rng(3)
    image = random.random(len(lattice))[lens].reshape(gray.image.shape)
    image += random.normal(0, 0.005, image.shape)
    unrelated = replace(gray, image=image.astype(np.float32))
    before = refine_grid(values, FINER, 0.04 * lattice.pitch)
    assert np.array_equal(locate_edges(unrelated, lattice, jump).surface.patch_size, before)
    assert not np.array_equal(locate_edges(gray, lattice, jump).surface.patch_size, before)


def test_parts_of_a_flat_have_the_same_edges(house_in_front):
    flat, calibration, *_ = house_in_front
    found = lfrender.analyze(flat, calibration, edges=True, roi=(60, 60, 330, 280))
    whole = lfrender.analyze(flat, calibration, edges=True)
    y, x = np.mgrid[110:230:3, 110:280:3]
    points = np.stack([x, y], -1).reshape(-1, 2).astype(float)
    apart = np.abs(found.surface.at(points) - whole.surface.at(points)) > 0.05 * whole.pitch
    assert apart.mean() < 0.03


def test_a_frame_after_another_has_edges_where_it_changed_and_the_old_ones_elsewhere(
    house_in_front,
):
    flat, calibration, *_ = house_in_front
    before = lfrender.analyze(flat, calibration, edges=True)
    changed = flat.copy()
    changed[100:200, 100:200] = flat[120:220, 140:240]
    after = lfrender.analyze(changed, calibration, edges=True, previous=(flat, before))
    assert after.surface.patch_size.shape == before.surface.patch_size.shape
    same = after.surface.patch_size == before.surface.patch_size
    # Far from the change all is as it was, and something is not within.
    v, u = (np.array([20, 150]) - before.surface.first[0]) / before.surface.spacing
    assert same[:, int(300 / before.surface.spacing) :].all()
    assert not same[int(v) : int(u), int(v) : int(u)].all()
