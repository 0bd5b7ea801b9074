"""Small captures that several tests look at; rendered once."""

from __future__ import annotations

import pytest

from data_synth import SCENES, Camera, Capture, simulate


@pytest.fixture(scope="session")
def small_camera() -> Camera:
    return Camera.design((260, 240), 24.0, "hex", 4.0)


@pytest.fixture(scope="session")
def house(small_camera: Camera) -> Capture:
    return simulate(SCENES["house"](small_camera), small_camera, samples=16, bits=16, gamma=False)
