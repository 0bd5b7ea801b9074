"""Depth edges on the pixels of the flat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

import lfrender
from data_synth import SCENES, Camera, simulate
from lfrender.depth.edges.geometry import mark_levels
from lfrender.depth.edges.locate_edges import locate_edges
from lfrender.depth.edges.settings import DEFAULT


@pytest.fixture(scope="module")
def house_in_front():
    """Branches before a house: flat, camera, depth without the edges, and the true surface."""
    camera = Camera.design(size=(420, 340), pitch=20.0)
    shot = simulate(SCENES["house"](camera), camera, samples=16, seed=9)
    calibration = shot.truth.calibration
    depth = lfrender.analyze(shot.flat, calibration)
    size = shot.truth.reference_patch_size
    nearest = distance_transform_edt(~np.isfinite(size), return_distances=False, return_indices=True)
    affine = shot.truth.reference_affine
    true = lfrender.data.surface.Surface(
        np.ascontiguousarray(size[tuple(nearest)], np.float32), (affine[0, 2], affine[1, 2]), affine[0, 0]
    )
    return shot.flat, calibration, depth, true


def test_fewer_places_beside_branches_have_the_depth_of_the_other_surface(house_in_front):
    flat, calibration, depth, true = house_in_front
    after = locate_edges(flat, calibration, depth)

    def wrong(found):
        surface = found.surface
        rows, columns = surface.patch_size.shape
        v, u = np.mgrid[:rows, :columns]
        points = np.stack([u, v], -1).reshape(-1, 2) * surface.spacing + surface.first
        apart = surface.patch_size - true.at(points).reshape(rows, columns)
        return float((np.abs(apart) > 0.05 * depth.pitch).mean())

    assert wrong(after) < 0.6 * wrong(depth)


def test_its_grid_is_finer_about_the_same_places(house_in_front):
    flat, calibration, depth, _ = house_in_front
    after, before = locate_edges(flat, calibration, depth).surface, depth.surface
    finer = len(after.patch_size) // len(before.patch_size)
    assert finer == round(before.spacing / after.spacing) == DEFAULT.finer
    middle = after.first[0] + 0.5 * (finer - 1) * after.spacing
    assert middle == pytest.approx(before.first[0])


def test_analyze_ends_with_it_where_asked_for(house_in_front):
    flat, calibration, depth, _ = house_in_front
    found = lfrender.analyze(flat, calibration, edges=True)
    assert np.array_equal(found.surface.patch_size, locate_edges(flat, calibration, depth).surface.patch_size)
    assert np.array_equal(found.patch_size, depth.patch_size, equal_nan=True)
    with pytest.raises(ValueError, match="neither roi nor previous"):
        lfrender.analyze(flat, calibration, edges=True, roi=(50, 50, 200, 200))


def test_a_surface_without_edges_is_left_alone(house_in_front):
    flat, calibration, depth, _ = house_in_front
    flat_surface = replace(depth.surface, patch_size=np.full_like(depth.surface.patch_size, 6.0))
    even = replace(depth, surface=flat_surface)
    assert locate_edges(flat, calibration, even) is even


def test_grey_flats_of_16_bits_give_edges_too(house_in_front):
    flat, calibration, depth, _ = house_in_front
    grey = (flat.mean(2, keepdims=True) * 257).astype(np.uint16)
    found = locate_edges(grey, calibration, depth)
    assert np.isfinite(found.surface.patch_size).all()
    assert not np.array_equal(found.surface.patch_size, depth.surface.patch_size)


def test_levels_are_marked_within_reach():
    surface = np.full((9, 9), 5.0, np.float32)
    surface[4, 4] = -5.0
    level = np.uint64((-5.0 / 20 + 0.8) * 40)
    marked = (mark_levels(surface, 20.0, 2) >> level) & np.uint64(1)
    assert marked[4, 6] and marked[6, 4] and marked[6, 6] and not marked[4, 7] and not marked[7, 4]
