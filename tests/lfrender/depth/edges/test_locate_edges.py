"""Depth edges on the pixels of the flat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

import lfrender
from data_synth import SCENES, Camera, simulate
from lfrender.data.surface import Surface
from lfrender.depth.edges.agreement import Agreement, measure_agreement
from lfrender.depth.edges.geometry import mark_levels
from lfrender.depth.edges.locate_edges import locate_edges
from lfrender.depth.edges.rims import keep_proven
from lfrender.depth.edges.settings import DEFAULT
from lfrender.depth.pipeline import prepare_flat
from lfrender.flat.lens_graph import nearest_lens


@pytest.fixture(scope="module")
def house_in_front():
    """Branches before a house: flat, camera, depth without the edges, the true surface, the grey flat, its lattice."""
    camera = Camera.design(size=(420, 340), pitch=20.0)
    shot = simulate(SCENES["house"](camera), camera, samples=16, seed=9)
    calibration = shot.truth.calibration
    depth = lfrender.analyze(shot.flat, calibration, edges=False)
    size = shot.truth.reference_patch_size
    nearest = distance_transform_edt(~np.isfinite(size), return_distances=False, return_indices=True)
    affine = shot.truth.reference_affine
    true = lfrender.data.surface.Surface(
        np.ascontiguousarray(size[tuple(nearest)], np.float32), (affine[0, 2], affine[1, 2]), affine[0, 0]
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


def test_its_grid_is_finer_about_the_same_places(house_in_front):
    _, _, depth, _, gray, lattice = house_in_front
    after, before = locate_edges(gray, lattice, depth).surface, depth.surface
    finer = len(after.patch_size) // len(before.patch_size)
    assert finer == round(before.spacing / after.spacing) == DEFAULT.finer
    middle = after.first[0] + 0.5 * (finer - 1) * after.spacing
    assert middle == pytest.approx(before.first[0])


def test_analyze_ends_with_it_where_asked_for(house_in_front):
    flat, calibration, depth, _, gray, lattice = house_in_front
    found = lfrender.analyze(flat, calibration, edges=True)
    assert np.array_equal(found.surface.patch_size, locate_edges(gray, lattice, depth).surface.patch_size)
    assert np.array_equal(found.patch_size, depth.patch_size, equal_nan=True)


def test_a_surface_without_edges_is_left_alone(house_in_front):
    _, _, depth, _, gray, lattice = house_in_front
    even = replace(depth, surface=replace(depth.surface, patch_size=np.full_like(depth.surface.patch_size, 6.0)))
    assert locate_edges(gray, lattice, even) is even


def test_a_place_that_hardly_another_lens_shows_keeps_its_depth(house_in_front):
    _, _, depth, _, gray, lattice = house_in_front
    values = np.full_like(depth.surface.patch_size, 0.66 * lattice.pitch)
    values[:, values.shape[1] // 2 :] = 6.0
    near = replace(depth, surface=replace(depth.surface, patch_size=values))
    after = locate_edges(gray, lattice, near).surface.patch_size
    assert (after[:, : after.shape[1] // 2 - 4] > 0.6 * lattice.pitch).all()


def test_parts_of_a_flat_have_the_same_edges(house_in_front):
    flat, calibration, *_ = house_in_front
    found = lfrender.analyze(flat, calibration, edges=True, roi=(60, 60, 330, 280))
    whole = lfrender.analyze(flat, calibration, edges=True)
    y, x = np.mgrid[110:230:3, 110:280:3]
    points = np.stack([x, y], -1).reshape(-1, 2).astype(float)
    apart = np.abs(found.surface.at(points) - whole.surface.at(points)) > 0.05 * whole.pitch
    assert apart.mean() < 0.03


def test_a_frame_after_another_has_edges_where_it_changed_and_the_old_ones_elsewhere(house_in_front):
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


def test_lenses_that_differ_in_their_light_agree_less(house_in_front):
    _, _, depth, _, gray, lattice = house_in_front
    rng = np.random.default_rng(0)
    gap = 0.04 * lattice.pitch
    even = replace(depth, filled_patch_size=np.full_like(depth.filled_patch_size, 6.0))
    light = np.ones_like(gray.image)
    for (x, y), factor in zip(gray.centres, rng.normal(1, 0.1, len(gray.centres)), strict=True):
        light[max(0, int(y) - 10) : int(y) + 10, max(0, int(x) - 10) : int(x) + 10] = factor
    uneven = replace(gray, image=np.ascontiguousarray(gray.image * light))
    assert measure_agreement(uneven, lattice, even, gap).share > 1.3 * measure_agreement(gray, lattice, even, gap).share


@pytest.mark.parametrize(("fixed", "share"), [(0.02, 0.0), (0.0, 0.05)])
def test_what_agrees_is_told_for_noise_and_for_light_that_grows_with_brightness(house_in_front, fixed, share):
    _, _, depth, _, gray, lattice = house_in_front
    even = replace(depth, filled_patch_size=np.full_like(depth.filled_patch_size, 6.0))
    rng = np.random.default_rng(1)
    # Lenses are compared with that to their right.
    image = np.repeat(np.linspace(0.1, 0.9, len(gray.image), dtype=np.float32)[:, None], gray.image.shape[1], 1)
    image += (rng.normal(0, 1, image.shape) * (fixed + share * image)).astype(np.float32)
    found = measure_agreement(replace(gray, image=image), lattice, even, 0.04 * lattice.pitch)
    bright, dark = (np.hypot(found.fixed, found.share * level) for level in (0.8, 0.2))
    # Two pixels differ by more than one from its mean, and so do patches of few pixels from the median of all.
    wanted = DEFAULT.noise * np.sqrt(2) * (fixed + share * np.array([0.8, 0.2]))
    assert bright == pytest.approx(wanted[0], rel=0.3)
    assert dark == pytest.approx(wanted[1], rel=0.5)


def test_a_region_stays_only_where_its_rim_has_contrast(house_in_front):
    _, _, _, _, gray, lattice = house_in_front
    image = np.full_like(gray.image, 0.5)
    # Lenses show the right half of this scene at a patch size of 6 px darker than the left one.
    centres = gray.centres[nearest_lens(lattice, np.argwhere(np.ones(image.shape))[:, ::-1])].reshape(*image.shape, 2)
    x = np.mgrid[: image.shape[0], : image.shape[1]][1]
    image[centres[..., 0] - (x - centres[..., 0]) * lattice.pitch / 6.0 > 200] = 0.3
    before = np.full((170, 210), -6.0, np.float32)
    values = before.copy()
    values[20:150, 101:] = 6.0
    values[60:100, 20:50] = 6.0
    values[140:, 80:] = values[:40, 80:] = -6.0
    found = keep_proven(Surface(values, (0.0, 0.0), 2.0), before, replace(gray, image=image), lattice,
                        Agreement(0.02, 0.05), 0.8)  # fmt: skip
    assert (found[60:100, 20:50] == -6).all()
    assert (found[45:135, 105:] == 6).all()


def test_levels_are_marked_within_reach():
    surface = np.full((9, 9), 5.0, np.float32)
    surface[4, 4] = -5.0
    level = np.uint64((-5.0 / 20 + 0.8) * 40)
    marked = (mark_levels(surface, 20.0, 2) >> level) & np.uint64(1)
    assert marked[4, 6] and marked[6, 4] and marked[6, 6] and not marked[4, 7] and not marked[7, 4]
