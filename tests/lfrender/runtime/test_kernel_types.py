"""Kernels are compiled for one set of argument types, wherever arrays come from: other code may
round differently.
"""

from __future__ import annotations

import pickle
import sys

import lfcal
import lfrender
from benchmarks.kernels import cached_kernels
from lfrender.flat.neighbours import neighbours_of


def compiled():
    """Signatures of the kernels that Python has called so far, by module and name."""
    return {
        (name, kernel.__name__): kernel.signatures
        for name, module in list(sys.modules.items())
        if name.split(".")[0] in ("lfcal", "lfrender")
        for kernel in cached_kernels(module)
    }


def test_unpickled_cameras_need_no_other_kernels(house):
    camera = house.truth.calibration
    depth = lfrender.analyze(house.flat, camera, "fast")
    lfrender.render(house.flat, camera, depth)
    before = compiled()
    assert sum(map(len, before.values())) > 20
    camera, depth = pickle.loads(pickle.dumps((camera, depth)))
    lfrender.render(house.flat, camera, lfrender.analyze(house.flat, camera, "fast"))
    lfrender.render(house.flat, camera, depth)
    assert compiled() == before


def test_neighbours_are_contiguous_as_after_unpickling():
    lattice = lfcal.Lattice((20.0, 30.0), [(12.0, 0.5), (6.0, 10.4)], (640, 480), 5.5)
    neighbours = neighbours_of(lattice)
    assert neighbours.forward.flags.c_contiguous and neighbours.backward.flags.c_contiguous
