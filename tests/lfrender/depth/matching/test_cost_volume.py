"""The matching cost of pairs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data_synth import SCENES, Camera, simulate
from lfcal import Calibration, Lattice
from lfrender.depth.matching.cost_volume import compute_pair_costs
from lfrender.flat import microimages
from lfrender.flat.gray_flat import make_gray_flat
from lfrender.flat.lens_graph import neighbour_rows
from lfrender.flat.microimages import extract_strips


@pytest.fixture(scope="module")
def house():
    camera = Camera.design(size=(420, 340), pitch=23.2, rotation=1.3)
    return simulate(SCENES["house"](camera), camera, samples=24, seed=2)


@pytest.mark.parametrize("row_step", [1, 2])
def test_costs_from_strips_agree_with_costs_from_the_flat(house, row_step):
    calibration = house.truth.calibration
    gray = make_gray_flat(house.flat, calibration)
    lattice = calibration.lattice
    rows = neighbour_rows(lattice, lattice.steps)[:, : len(lattice.steps) // 2]
    means = np.full(len(lattice), 0.4, np.float32)
    strips = extract_strips(gray, means, row_step)
    assert 0.6 < strips.complete.mean() < 1
    shifts = np.arange(-14, 15, 2).astype(np.float32)
    few = (np.arange(len(lattice)) % 4 == 0).astype(bool)
    quick, slow = (
        compute_pair_costs(gray, rows, means, means, few, shifts, 0.004, 0.02, row_step, strips=s)
        for s in (strips, replace(strips, complete=np.zeros(len(lattice), bool)))
    )
    # Pixels at the rim differ: discs are centred at the lens in the flat, at its middle pixel in strips.
    assert np.corrcoef(quick.ravel(), slow.ravel())[0, 1] > 0.9
    assert np.median(np.abs(quick - slow)) < 0.02
    # For small overlaps both use the centre of the lens, but the rows that are read may differ.
    far = np.abs(shifts) > 12
    tried = few[:, None] & (rows >= 0)
    assert (quick[tried][:, far] < 1).mean() > 0.3
    if row_step == 1:
        assert (np.abs(quick - slow)[tried][:, far] < 1e-3).mean() > 0.999


@pytest.mark.parametrize("pitch", [30, 38, 42])
def test_costs_do_not_depend_on_what_memory_holds_behind_the_microimages(pitch, monkeypatch):
    def allocate(shape, kind):
        return np.full(shape[0] + 999, np.nan, kind)[: shape[0]]

    monkeypatch.setattr(microimages, "allocate_pooled", allocate)
    size = (6 * pitch, 5 * pitch)
    lattice = Lattice([0.6 * pitch, 0.6 * pitch], [[pitch, 0], [0, pitch]], size, 0.5 * pitch - 0.5)
    rows = neighbour_rows(lattice, lattice.steps)[:, : len(lattice.steps) // 2]
    flat = np.random.default_rng(0).random((*size[::-1], 1), np.float32)
    means, every = np.full(len(lattice), 0.5, np.float32), np.ones(len(lattice), bool)
    shifts = np.arange(-int(0.82 * pitch), int(0.82 * pitch) + 1).astype(np.float32)
    gray = make_gray_flat(flat, Calibration(lattice))
    costs = compute_pair_costs(gray, rows, means, means, every, shifts, 0.004, 0.02)
    assert np.isfinite(costs).all()
