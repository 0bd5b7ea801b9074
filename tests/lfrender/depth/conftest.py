"""Scenes of planes and cards, and the comparison with the exhaustive search, for tests of the depth
analysis.
"""

from __future__ import annotations

import functools
from types import SimpleNamespace

import numpy as np
import pytest

import lfrender
from data_synth import Camera, Scene, simulate
from data_synth.scenes import plane
from data_synth.surfaces import Patch

SIZE = (640, 480)


@functools.cache
def camera():
    return Camera.design(size=SIZE, pitch=23.2, lattice="hex", rotation=1.3)


def shot_of(*surfaces, noise=None, samples=12):
    return simulate(Scene("some", surfaces), camera(), samples=samples, seed=2, noise=noise)


def card(ratio, low, high):
    """A textured card at `s / D = ratio` over the flat pixels from `low` to `high`."""
    wide = plane(camera(), ratio=ratio).surfaces[0]
    depth = camera().depth_at(ratio)
    corner, right, below = camera().place([low, (high[0], low[1]), (low[0], high[1])], depth)
    part = wide.texture[:160, : 160 * (high[0] - low[0]) // (high[1] - low[1])]
    return Patch(corner, right - corner, below - corner, part)


@functools.cache
def one_plane():
    return shot_of(*plane(camera(), ratio=0.3).surfaces)


def both(shot, skip=True, **options):
    calibration = shot.truth.calibration
    return lfrender.analyze(shot.flat, calibration, skip=False), lfrender.analyze(
        shot.flat, calibration, skip=skip, **options
    )


def agreement(full, quick):
    """Share of the lenses that are resolved in both, or in neither, and differ by less than 0.05
    px.
    """
    near = np.abs(full.patch_size - quick.patch_size) < 0.05
    return np.mean(near | ((full.mode == 0) & (quick.mode == 0)))


@pytest.fixture(scope="session")
def scenes():
    """Functions that make scenes of a camera of 640 x 480 px and 23.2 px pitch, and compare
    analyses of them.
    """
    return SimpleNamespace(
        camera=camera,
        shot_of=shot_of,
        card=card,
        one_plane=one_plane,
        both=both,
        agreement=agreement,
        size=SIZE,
    )
