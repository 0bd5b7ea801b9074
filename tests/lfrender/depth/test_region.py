"""Parts of a flat: which lenses are estimated, which keep what they had, and what a crop holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lfrender.data.depth_map import DepthMap
from lfrender.data.surface import constant_surface
from lfrender.depth.region import Part, rows_of


def part_of(drawn_flat, s=7.0):
    gray, lattice, *_ = drawn_flat(s)
    return Part(gray, lattice, "fast")


def test_all_lenses_of_a_part_without_an_earlier_frame_are_estimated(drawn_flat):
    part = part_of(drawn_flat)
    assert part.updated.all() and part.near_updated(2).all()
    assert np.isnan(part.kept_sizes).all() and not part.kept_resolved.any()


def test_lenses_that_have_not_changed_keep_their_patch_size(drawn_flat):
    part = part_of(drawn_flat)
    lenses = len(part.lattice)
    changed = np.zeros(lenses, bool)
    middle = int(np.abs(part.lattice.centres() - part.lattice.centres().mean(0)).sum(1).argmin())
    changed[middle] = True
    sizes = np.linspace(5, 8, lenses).astype(np.float32)
    reason = np.zeros(lenses, np.int8)
    reason[0] = 1
    before = DepthMap(
        patch_size=np.where(reason == 0, sizes, np.float32(np.nan)),
        standard_error=np.where(reason == 0, 0.1, np.inf).astype(np.float32),
        confidence=np.ones(lenses, np.float32),
        filled_patch_size=sizes,
        reason=reason,
        surface=constant_surface(7.0),
        pitch=part.lattice.pitch,
        image_size=part.lattice.image_size,
        preset="fast",
    )
    part = replace(part, before=before, changed=changed)
    np.testing.assert_array_equal(np.isnan(part.kept_sizes), changed)
    np.testing.assert_array_equal(part.kept_sizes[~changed], sizes[~changed])
    np.testing.assert_array_equal(np.flatnonzero(~part.kept_resolved), sorted({0, middle}))
    around = part.neighbours.all[middle]
    assert part.near_updated().sum() == 1 + len(around) and part.near_updated()[around].all()
    assert part.near_updated(2).sum() > part.near_updated().sum()


def test_a_crop_holds_the_pixels_about_its_lenses(drawn_flat):
    part = part_of(drawn_flat)
    centres = part.lattice.centres()
    inside = (np.abs(centres - centres.mean(0)) < 1.2 * part.lattice.pitch).all(1)
    cut = part.crop(inside)
    rows = rows_of(cut.lattice, part.lattice)
    assert inside[rows].sum() == inside.sum() and len(rows) <= len(inside)
    moved = part.gray.centres[rows] - cut.gray.centres
    left, top = np.rint(moved[0]).astype(int)
    np.testing.assert_allclose(moved, np.broadcast_to([left, top], moved.shape), atol=1e-3)
    height, width = cut.gray.image.shape
    np.testing.assert_array_equal(
        cut.gray.image, part.gray.image[top : top + height, left : left + width]
    )
