"""Kernels are compiled for one set of argument types, wherever arrays come from: other code may round differently."""

from __future__ import annotations

import pickle
import sys

import lfcal
import lfrender
from lfcal.runtime.kernels.jit import Kernel
from lfrender.flat.lens_graph import opposite_neighbours


def compiled():
    """Signatures of all kernels that are compiled or loaded so far, by module and name."""
    modules = [(name, module) for name, module in sys.modules.items() if name.split(".")[0] in ("lfcal", "lfrender")]
    return {
        (name, key): tuple(map(str, kernel.signatures))
        for name, module in modules
        for key, kernel in vars(module).items()
        if isinstance(kernel, Kernel) and "dispatcher" in vars(kernel)
    }


def test_unpickled_cameras_need_no_other_kernels(house):
    camera = house.truth.calibration
    depth = lfrender.analyze(house.flat, camera, "fast")
    lfrender.render(house.flat, camera, depth)
    before = compiled()
    # Kernels that others call are listed where they have been compiled, not where they come from the disk: then 43.
    assert sum(map(len, before.values())) > 40
    camera, depth = pickle.loads(pickle.dumps((camera, depth)))
    lfrender.render(house.flat, camera, lfrender.analyze(house.flat, camera, "fast"))
    lfrender.render(house.flat, camera, depth)
    assert compiled() == before


def test_neighbours_are_contiguous_as_after_unpickling():
    lattice = lfcal.Lattice((20.0, 30.0), [(12.0, 0.5), (6.0, 10.4)], (640, 480), 5.5)
    assert all(half.flags.c_contiguous for half in opposite_neighbours(lattice))
