"""A small flat with its camera and depth: the inputs of the examples in this documentation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from ..data.depth_map import DepthMap
from ..data.samples import house
from .analyze import analyze

__all__ = ["example"]


def example() -> tuple[NDArray[np.uint8], Calibration, DepthMap]:
    """A small flat of the house, its true camera, and its depth with the preset `fast`: the inputs
    of the examples.

    Examples
    --------
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> flat.shape, len(depth) == len(camera.lattice)
    ((180, 240, 3), True)
    """
    sample = house(size=(240, 180), samples=2)
    camera = sample.truth.calibration
    return sample.flat, camera, analyze(sample.flat, camera, "fast", check=False)
