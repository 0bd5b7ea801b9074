"""Confirm a camera on a flat in a few milliseconds, by the average cells of parts of the flat.

The light of the camera's own gain map is matched with the average cell of each part, at all shifts.
A camera is confirmed where every part matches well at hardly any shift, and the shifts of the parts
show neither another pitch nor another rotation. Whatever is less clear needs the evidence of the
lattice (`flat_lattice`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..camera.calibration import Calibration
from ..gain.gain_map import GainMap
from ..lattice.cell import bin_offsets
from ..lattice.lattice import Lattice
from ..runtime.arrays import Floats, Singles
from .misfit import Misfit

__all__ = ["match_gain"]

# Parts along the shorter side of a flat.
_PARTS = 4
# Least correlation of the average cell of a part with the gain map. Right cameras have 0.71 to 0.97
# on eleven captures; with a half or a third of the cell, 0.81 at most, at shifts of 0.06 and more.
_MATCH = 0.7
# Largest shift of a part beside a linear function of the place [pitch].
_BESIDE = 0.06


class _Match(NamedTuple):
    """The best match of the average cell of a part."""

    centre: Floats  # (2,) [px] of the part
    shift: Floats  # (2,) [px] of its microimages from the lattice
    correlation: float


def match_gain(calibration: Calibration, small: Lattice, picture: Singles) -> Misfit | None:
    """The offset of the microimages on a picture from a camera, if they are certainly its own; None
    if that is open.

    `picture` (h, w) is the root of the luminance of a flat, `small` the lattice of the camera on
    the picture, which may be downscaled.
    """
    gain = calibration.gain_map
    # Distortion and mechanical vignetting move average cells too.
    if gain is None or len(gain.cut) or small.distortion is not None:
        return None
    found = _match_parts(gain, calibration.lattice, small, picture)
    if min(one.correlation for one in found) < _MATCH:
        return None
    middle = (np.array(small.image_size) - 1) / 2
    places = np.array([one.centre - middle for one in found])
    shifts = np.array([one.shift for one in found])
    design = np.column_stack([np.ones(len(places)), places])
    line = np.linalg.lstsq(design, shifts, rcond=None)[0]
    misfit = Misfit(line[0], line[1:], small.image_size, small.pitch)
    beside = np.linalg.norm(shifts - design @ line, axis=1).max() / small.pitch
    if misfit.is_negligible and beside < _BESIDE:
        return misfit
    return None


def _match_parts(gain: GainMap, lattice: Lattice, small: Lattice, picture: Singles) -> list[_Match]:
    from ..detection.folding import BINS, fold_tiles
    from ..images.preprocessing import normalise_locally

    level = normalise_locally(picture, 2 * small.pitch)
    fold = fold_tiles([level], small.basis, min(picture.shape) // _PARTS)[0]
    centre = small.origin @ np.linalg.inv(small.basis)
    expected = _spectrum(_expected_cell(gain, lattice, centre, BINS))
    found = []
    for part, place in enumerate(fold.centre):
        correlation = np.fft.ifft2(_spectrum(fold.mean([part])) * expected.conj()).real
        row, column = np.unravel_index(int(correlation.argmax()), correlation.shape)
        # The maximum between bins, of a parabola each way.
        across = column + _vertex(np.roll(correlation[row], 1 - column)[:3])
        down = row + _vertex(np.roll(correlation[:, column], 1 - row)[:3])
        bins = (np.array([across, down]) + BINS / 2) % BINS - BINS / 2
        highest = float(correlation[row, column]) * correlation.size
        found.append(_Match(place, bins / BINS @ small.basis, highest))
    return found


def _expected_cell(gain: GainMap, lattice: Lattice, centre: Floats, bins: int) -> Floats:
    """Root of the light (bins, bins) in the cell of the middle lens.

    `centre` (2,) [cells] is the place of the lens.
    """
    x, y = np.ascontiguousarray(bin_offsets(lattice.basis, bins, centre).reshape(-1, 2).T)
    lens = gain.describe(lattice.field_place(lattice.points(lattice.middle[None])))
    light = gain.evaluate(lens, np.zeros(len(x), np.int64), x, y)[0]
    return np.sqrt(np.maximum(light, 0)).reshape(bins, bins)


def _spectrum(cell: Floats) -> Floats:
    """Spectrum of the deviations of a cell from their mean, whose squares sum up to one."""
    spectrum = np.fft.fft2(cell - cell.mean())
    return np.asarray(spectrum / max(float(np.linalg.norm(spectrum)), 1e-30))


def _vertex(values: Floats) -> float:
    """Place of the vertex of a parabola through three values, from the middle one."""
    left, middle, right = values
    bend = left - 2 * middle + right
    if bend < 0:
        return float(0.5 * (left - right) / bend)
    return 0.0
