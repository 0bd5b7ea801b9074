"""Pairs of lenses of two types, which blur differently."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from data_synth import SCENES, Camera, simulate
from lfrender.depth.refinement.lens_plane import fit_lens_planes
from lfrender.depth.refinement.pair_fit import fit_pairs
from lfrender.flat.gray_flat import make_gray_flat
from lfrender.flat.neighbours import neighbours_of

RATIO = -0.4
FOCUS = (-0.1, 0.04, 0.18)


@cache
def flat(gamma: bool = True, focus: tuple[float, ...] | float = FOCUS):
    camera = Camera.design((420, 360), 23.2, focus=focus)
    return simulate(
        SCENES["plane"](camera, ratio=RATIO, seed=3),
        camera,
        samples=64,
        seed=3,
        gamma=gamma,
        bits=16,
    )


def errors(kinds: bool, gamma: bool = True) -> np.ndarray:
    """Errors of single lenses [px]."""
    shot = flat(gamma)
    gray = make_gray_flat(shot.flat, shot.truth.calibration)
    gray = replace(gray, lens_type=shot.truth.lens_type.astype(np.int8) if kinds else None)
    start = (shot.truth.patch_size + 0.2).astype(np.float32)
    neighbours = neighbours_of(shot.truth.calibration.lattice)
    pairs = fit_pairs(
        gray, neighbours.forward, start, np.full(len(start), 0.1, np.float32), 0.004, 5
    )
    alone = fit_lens_planes(gray, neighbours, pairs, start)
    inner = (np.abs(gray.centres - np.array([209.5, 179.5])) < np.array([150, 120])).all(1)
    return (alone.patch_size - shot.truth.patch_size)[inner]


@pytest.mark.parametrize("gamma", [True, False])
def test_pairs_of_unlike_lenses_scatter_less_once_their_types_are_known(gamma):
    before, after = (errors(kinds, gamma) for kinds in (False, True))
    assert np.sqrt(np.mean(after**2)) < 0.6 * np.sqrt(np.mean(before**2))
