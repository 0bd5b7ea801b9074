"""The lenses of a camera as the kernels of blending look them up."""

from __future__ import annotations

import numpy as np

from lfcal import Calibration

from ...flat.distorted_lookup import lens_displacements
from ...flat.gray_flat import correction_cell
from ...flat.lens_graph import lens_offsets
from ...flat.lens_type_weights import focus_weights
from .records import Lenses

__all__ = ["tabulate_lenses"]


def tabulate_lenses(calibration: Calibration, reach: float) -> tuple[Lenses, np.ndarray]:
    """The lenses by y, none of them `edged`, and their order (n,) in the lattice.

    `reach` [px] is that of lenses about a scene point.
    """
    lattice = calibration.lattice
    centres, index = lattice.centres(), lattice.indices()
    order = np.argsort(centres[:, 1], kind="stable")
    low = index.min(0)
    rows = np.full((index.max(0) - low + 1)[::-1], -1, np.int32)
    rows[tuple((index[order] - low).T[::-1])] = np.arange(len(order))
    cell, shares = focus_weights(calibration.lens_types)
    types, tables = (
        one[tuple((index[order] % len(one)).T)].astype(np.int64) if one.size else np.zeros(len(order), np.int64)
        for one in (cell, correction_cell(calibration))
    )
    displacements, lowest = lens_displacements(lattice)
    offsets, steps = lens_offsets(lattice, reach)
    lenses = Lenses(
        centres[order], types, tables, np.zeros(len(order), bool), rows, low, lattice.origin,
        np.linalg.inv(lattice.basis), displacements, lowest, np.ascontiguousarray(offsets[:, 2]), steps, shares,
        np.float32(lattice.pitch),
    )  # fmt: skip
    return lenses, order
