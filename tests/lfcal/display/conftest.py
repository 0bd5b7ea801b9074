"""A white image with its camera, and the same camera moved beside it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

import lfcal

_SIZE = (600, 500)


@dataclass
class Checked:
    """A white image and its camera."""

    image: Any
    camera: lfcal.Calibration
    middle = (np.array(_SIZE) - 1) / 2

    def moved(self, shift=(0.0, 0.0), change=None):
        """The camera, its lattice shifted and changed about the middle of the flat."""
        change = np.eye(2) if change is None else change
        lattice = self.camera.lattice
        origin = self.middle + (lattice.origin - self.middle) @ change + shift
        return replace(
            self.camera, lattice=lfcal.Lattice(origin, lattice.basis @ change, _SIZE, 9.0)
        )

    @staticmethod
    def turn(degrees):
        cos = np.cos(np.radians(degrees))
        sin = np.sin(np.radians(degrees))
        return np.array([[cos, sin], [-sin, cos]])


@pytest.fixture(scope="session")
def white(whites):
    """A white image of 20.3 px pitch."""
    basis = whites.turned(whites.HEXAGON, 20.3, 3)
    image, origin = whites.white_image(basis, _SIZE)
    return Checked(image, lfcal.Calibration(lfcal.Lattice(origin, basis, _SIZE, 9.0)))
