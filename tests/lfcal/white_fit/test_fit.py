"""White images of the benchmark: whole, cut and distorted microimages against their true centres."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

import lfcal


def _error(camera, truth):
    found = camera.lattice.centres()
    return float(np.sqrt(((found - truth.centres(truth.index_of(found))) ** 2).sum(1).mean()))


@pytest.mark.parametrize("decibels", [40, 26, 18])
def test_whole_microimages_are_placed_within_three_times_the_bound(drawn, decibels):
    truth = drawn("hexagonal", 14.3, 11.0, decibels, size=(900, 700))
    camera = lfcal.calibrate(truth.image())
    assert camera.lattice.distortion is None
    assert _error(camera, truth) < 3 * truth.bound()


@pytest.mark.parametrize("strength", [0.3, -0.3])
def test_cut_microimages_are_placed_by_their_whole_discs_and_agree_with_their_flat(drawn, strength):
    truth = drawn("hexagonal", 20.3, 5.0, 26.0, strength=strength, size=(1000, 800))
    image = truth.image()
    camera = lfcal.calibrate(image)
    assert _error(camera, truth) < 0.02
    # Rims of cut microimages are up to half a pixel off the lattice, which the camera knows.
    assert lfcal.check_fit(camera, image).max_offset < 0.15


def test_distorted_lattice_is_followed(drawn):
    truth = drawn("square", 20.3, 5.0, 26.0, k1=0.005, size=(1000, 800))
    camera = lfcal.calibrate(truth.image())
    assert camera.lattice.distortion is not None
    assert _error(camera, truth) < 0.02


def test_light_that_falls_about_the_place_below_the_microlens_does_not_move_centres(drawn):
    truth = drawn("hexagonal", 20.3, 5.0, 32.0, size=(1000, 800), inner=0.0)
    image = truth.image()
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    places = np.column_stack([x.ravel(), y.ravel()])
    centres = truth.centres(lfcal.Lattice(truth.origin, truth.basis, truth.size, 9.0).indices())
    centres = centres[cKDTree(centres).query(places)[1]]
    # cos^4 of the angle at 100 px from a microlens that lies 1 % nearer to the axis than its microimage.
    aside = places - centres + 0.01 * (centres - np.array(truth.size) / 2)
    fall = (1 + (aside**2).sum(1) / 100**2) ** -2
    camera = lfcal.calibrate(np.rint(image * fall.reshape(image.shape)).astype(image.dtype))
    assert _error(camera, truth) < 0.001


def test_stated_errors_of_centres_are_those_found(drawn):
    ratios = []
    for seed in range(4):
        truth = drawn("hexagonal", 14.3, 11.0, 26.0, size=(700, 500), seed=10 * seed)
        camera = lfcal.calibrate(truth.image())
        stated = np.sqrt((camera.errors.of_centres(camera.lattice) ** 2).mean())
        ratios.append(_error(camera, truth) / stated)
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 1.8


def test_film_scanned_with_a_general_distortion_is_followed(drawn):
    truth = drawn("square", 20.3, 5.0, 26.0, size=(1000, 800))
    y, x = np.mgrid[:800, :1000].astype(np.float32)
    bent = (x - 500) * (y - 400) / 300_000 * 4, ((x - 500) / 500) ** 3 * 3
    import cv2

    image = cv2.remap(truth.image(), x + bent[0].astype(np.float32), y + bent[1].astype(np.float32), cv2.INTER_CUBIC)
    camera = lfcal.calibrate(image)
    centres = camera.lattice.centres()
    back = centres.copy()
    back[:, 0] += (centres[:, 0] - 500) * (centres[:, 1] - 400) / 300_000 * 4
    back[:, 1] += ((centres[:, 0] - 500) / 500) ** 3 * 3
    inside = ((back > 5) & (back < np.array([995, 795]))).all(1)
    miss = back[inside] - truth.centres(truth.index_of(back[inside]))
    assert camera.lattice.distortion.general is not None
    assert np.sqrt((miss**2).sum(1).mean()) < 0.05


def test_even_inside_of_a_large_microimage_is_seen_in_one_pixel_of_sixteen(drawn):
    from lfcal.images.preprocessing import sqrt_luminance
    from lfcal.lattice.lens_subset import StackedCrops
    from lfcal.white_fit.cutouts import cut_out_lenses
    from lfcal.white_fit.model import WhiteModel
    from lfcal.white_fit.normal_equations import build_normal_equations

    truth = drawn("hexagonal", 60.3, 5.0, 26.0, size=(500, 450))
    lattice = lfcal.Lattice(truth.origin, truth.basis, truth.size, 25.0)
    state, _ = cut_out_lenses(StackedCrops.of(sqrt_luminance(truth.image())), WhiteModel(lattice, None), 1e6, 12, None)
    lenses = state.lenses
    cost = build_normal_equations(lenses).cost
    light = lenses.light.copy()
    y, x = np.indices(light.shape[1:])
    far = np.hypot(x + lenses.corners[0, 0] - lenses.centres[0, 0], y + lenses.corners[0, 1] - lenses.centres[0, 1])
    inside = far < 22
    seen = []
    for v, u in np.argwhere(inside)[::7]:
        other = dataclasses.replace(lenses, light=np.where((y == v) & (x == u), 0, light))
        seen.append(build_normal_equations(other).cost != cost)
    assert 0.03 < np.mean(seen) < 0.1
