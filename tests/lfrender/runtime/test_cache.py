"""Values are cached per owner, and deleted with it."""

from __future__ import annotations

import gc
import weakref

import numpy as np

from lfcal import Lattice
from lfrender.runtime.cache import cached, cached_latest


def _owner() -> Lattice:
    return Lattice(np.zeros(2), np.eye(2) * 9, (50, 50), 4.0)


def test_a_value_is_made_once_and_freed_with_its_owner():
    owner = _owner()
    made = []
    first = cached(owner, "array", lambda: made.append(1) or np.zeros(3))
    assert cached(owner, "array", lambda: made.append(1) or np.zeros(3)) is first
    assert len(made) == 1
    value = weakref.ref(first)
    del owner, first
    gc.collect()
    assert value() is None


def test_only_the_latest_value_of_a_name_is_kept():
    owner = _owner()
    made = []

    def make():
        made.append(len(made))
        return made[-1]

    assert [cached_latest(owner, "part", key, make) for key in ("a", "a", "b", "b", "a")] == [
        0,
        0,
        1,
        1,
        2,
    ]
