"""Analysis of a part of a flat."""

from __future__ import annotations

import numpy as np

from lfcal import Lattice
from lfrender.data.region import crop_flat
from lfrender.flat.gray_flat import GrayFlat


def test_the_lattice_of_a_part_is_reused_for_the_next_frame():
    lattice = Lattice(np.array([5.0, 6.0]), np.array([[20.0, 0.0], [10.0, 17.3]]), (400, 300), 9.0)
    centres = lattice.centres()
    gray = GrayFlat(np.zeros((300, 400), np.float32), centres.astype(np.float32), 9.0, 20.0)
    left, right = centres[:, 0] < 60, centres[:, 0] > 340
    part, sub = crop_flat(gray, lattice, left)
    assert crop_flat(gray, lattice, left)[1] is sub
    other, beside = crop_flat(gray, lattice, right)
    assert beside is not sub
    assert part.image.shape[::-1] == sub.image_size
    assert other.image.shape[::-1] == beside.image_size
    assert set(map(tuple, centres[left].round(6))) <= set(map(tuple, sub.centres().round(6)))


def test_lenses_of_a_part_keep_their_types():
    lattice = Lattice(np.array([5.0, 6.0]), np.array([[20.0, 0.0], [10.0, 17.3]]), (400, 300), 9.0)
    centres, (i, j) = lattice.centres(), lattice.indices().T
    kinds = ((i - j) % 3).astype(np.int8)
    gray = GrayFlat(np.zeros((300, 400), np.float32), centres.astype(np.float32), 9.0, 20.0, kinds)
    part, sub = crop_flat(gray, lattice, (centres[:, 0] > 150) & (centres[:, 1] > 110))
    low = np.array([400, 300]) - sub.image_size
    found = {tuple(place): kind for place, kind in zip((sub.centres() + low).round(3), part.lens_type, strict=True)}
    known = {tuple(place): kind for place, kind in zip(centres.round(3), kinds, strict=True)}
    assert len(found) > 50 and found.items() <= known.items()
