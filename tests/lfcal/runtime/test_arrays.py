"""Arrays of frozen dataclasses are read-only, also in copies and out of pickles; 8 bits of any
type.
"""

from __future__ import annotations

import copy
import pickle
import weakref
from dataclasses import fields, replace

import numpy as np
import pytest

import lfcal
import lfrender
from lfcal.camera.lens_types import LensTypes


def arrays(frozen):
    return {
        f.name: v for f in fields(frozen) if isinstance(v := getattr(frozen, f.name), np.ndarray)
    }


@pytest.mark.parametrize(
    "again", [copy.copy, copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))]
)
@pytest.mark.parametrize(
    "frozen",
    [
        lfcal.Lattice((20.0, 30.0), [(12.0, 0.5), (6.0, 10.4)], (640, 480), 5.5),
        LensTypes([[0, 2, 1], [1, 0, 2], [2, 1, 0]], True, [-0.2, 0.1, 0.3]),
    ],
)
def test_arrays_stay_read_only_in_copies_and_out_of_pickles(frozen, again):
    other = again(frozen)
    assert len(arrays(other)) >= 2
    for name, values in arrays(other).items():
        np.testing.assert_array_equal(values, getattr(frozen, name))
        assert not values.flags.writeable
        assert values.flags.c_contiguous


def test_cameras_and_depth_maps_compare_by_value(house):
    camera = house.truth.calibration
    same = pickle.loads(pickle.dumps(camera))
    assert camera == same and camera.lattice == same.lattice and camera is not same
    moved = replace(camera, lattice=replace(camera.lattice, origin=camera.lattice.origin + 0.5))
    assert camera != moved and camera != "camera"
    depth = lfrender.analyze(house.flat, camera, "fast")
    assert depth == copy.deepcopy(depth)
    assert depth != replace(depth, pitch=depth.pitch + 1)
    picture = lfrender.render(house.flat, camera, depth)
    assert picture == copy.copy(picture) and picture != replace(picture, image=picture.image // 2)


def test_a_derived_value_is_made_once_for_a_key_and_freed_with_its_record():
    lattice = lfcal.Lattice((0, 0), np.eye(2) * 9, (50, 50), 4.0)
    made = []

    def make(_, key):
        made.append(key)
        return np.zeros(3)

    first = lattice.derived(make, "a")
    assert lattice.derived(make, "a") is first
    assert lattice.derived(make, "b") is not first
    assert made == ["a", "b"]
    copy.deepcopy(lattice).derived(make, "b")
    assert made == ["a", "b", "b"]
    value = weakref.ref(lattice.derived(make, "b"))
    del lattice
    assert value() is None
