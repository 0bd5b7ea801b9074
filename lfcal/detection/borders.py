"""Borders of microimages without gaps: straight lines through the flat on which brightness steps.

Elemental images of an array of square lenses touch each other, so that nothing but these lines
repeats. Each family of parallel lines is a comb in the spectrum of the steps, on a ray through zero
frequency (projection-slice theorem). Its direction is that of the ray with most energy, its period
that of the comb. A profile of the steps across the lines then tells borders from content: content
repeats too if neighbours show nearly the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import cv2
import numpy as np

from ..lattice.lattice import reduce_basis
from ..lattice.robust_fit import field_rms, robust_sigma
from ..runtime.arrays import Booleans, Floats, Singles
from ..runtime.kernels import kernel
from .tile_lattice import HarmonicFit

__all__ = [
    "LineFamily",
    "LineProfile",
    "find_line_periods",
    "fit_touching_cells",
]

#: [px] side of the windows whose spectra are averaged, and shortest distance between lines.
_WINDOW = 1024
_SHORTEST = 6.0
#: [bins] side of the square whose mean is the background of a spectrum.
_BACKGROUND = 33
#: [robust standard deviations] a ray may be a comb if its energy exceeds the median of all rays by
#: this: random content reaches 4, and 24 arrays without gaps have 7.6 and more.
_CLEAR_RAY = 6.0
#: [degrees] least angle between the two families of lines.
_LEAST_ANGLE = 30.0
#: Periods of a ray that are compared by their profiles, and least contrast of such a profile:
#: borders of 24 arrays have 0.46 and more, multiples and fractions of their periods 0.17 at most.
_PERIODS = 6
_LEAST_CONTRAST = 0.3
#: Parts of each side of a flat in which lines are compared.
_PARTS = 4
#: Cells that a profile is folded over: lines of a multiple of the period differ among them.
_CELLS = 6
#: [px] distance from a line within which its steps lie.
_NEAR = 1.6
#: [pitch] distance from the border up to which a narrow gap may reach.
_GAP = 0.06
#: [local deviations] least excess of the steps on lines over those between lines; less is chance.
_LEAST_STEP = 0.03
#: [robust standard deviations] least excess relative to the scatter of the profile between lines.
_LEAST_PROMINENCE = 5.0


@kernel(error_model="numpy")
def _fold_lines(steps, across, down, total, count):
    """Add the steps (h, w) to the bins (n,) of one turn of `across` x + `down` y, and count them.

    The pixels of a whole number of turns lie in the middle of the first bin.
    """
    height, width = steps.shape
    bins = len(total)
    place = np.empty(width, np.int32)
    for y in range(height):
        for x in range(width):
            turns = y * down + x * across
            place[x] = np.int32(np.rint((turns - np.floor(turns)) * bins))
        for x in range(width):
            nearest = place[x]
            if nearest == bins:
                nearest = 0
            total[nearest] += steps[y, x]
            count[nearest] += 1.0


@dataclass(frozen=True)
class LineProfile:
    """Mean steps across a family of parallel lines, over `_CELLS` periods.

    Parameters
    ----------
    mean : (_CELLS, bins) float64 [local deviations]
        By the fractional coordinate across the lines, from 0 at the pixel (0, 0) on.
    period : float [px]
        Distance between the lines.
    """

    mean: Floats
    period: float

    @classmethod
    def measure(cls, steps: Singles, frequency: Floats) -> LineProfile:
        """Profile of steps (h, w) along `frequency` (2,) [cycles per px]."""
        period = float(1 / np.hypot(*frequency))
        bins = max(int(period), 6)
        total = np.zeros(_CELLS * bins)
        count = np.zeros(_CELLS * bins)
        _fold_lines(np.ascontiguousarray(steps), *frequency / _CELLS, total, count)
        mean = total / np.maximum(count, 1)
        return cls(mean.reshape(_CELLS, bins), period)

    @cached_property
    def strongest(self) -> float:
        """Fractional coordinate 0..1 of the strongest line."""
        bins = self.mean.shape[1]
        return int(self.mean.mean(0).argmax()) / bins

    def find_line(self, border: float) -> tuple[float, float]:
        """Distance [cells] of the strongest line within a quarter of a cell of `border`; its steps
        less the median of all.
        """
        whole = self.mean.mean(0) - np.median(self.mean.mean(0))
        bins = len(whole)
        away = (np.arange(bins) / bins - border + 0.5) % 1 - 0.5
        near = np.flatnonzero(np.abs(away) < 0.25)
        best = int(near[whole[near].argmax()])
        beside = np.array([whole[best - 1], whole[best], whole[(best + 1) % bins]]).clip(0)
        within = float(beside @ [-1, 0, 1]) / max(float(beside.sum()), 1e-9)
        return float(away[best]) + within / bins, float(whole[best])

    def contrast(self, border: float) -> float:
        """How far the lines at the fractional coordinate `border` stand out from all between them.

        The steps on the weakest lines less those at the strongest place between lines, over those
        on all lines less the median between them: 1 for borders; 0 or less if other lines are as
        strong, or if only every second or third line is one.
        """
        near, between = self._parts(border)
        if not near.any() or not between.any():
            return 0.0
        whole = self.mean.mean(0)
        usual = float(np.median(whole[between]))
        scatter = robust_sigma(whole[between] - usual)
        height = float(whole[near].max()) - usual
        if height < max(_LEAST_STEP, _LEAST_PROMINENCE * scatter):
            return 0.0
        lines = self.mean[:, near].max(1)
        groups = [float(lines[first::every].mean()) for every in (2, 3) for first in range(every)]
        weakest = min(*groups, float(whole[near].max()))
        return (weakest - float(whole[between].max())) / height

    def _parts(self, border: float) -> tuple[Booleans, Booleans]:
        """(bins,) places on the lines and between them."""
        bins = self.mean.shape[1]
        place = np.arange(bins) / bins
        away = np.abs((place - border + 0.5) % 1 - 0.5) * self.period
        near = away < max(min(_NEAR, self.period / 8), 0.75 * self.period / bins)
        between = away > max(_NEAR + 1, _GAP * self.period)
        return near, between


def find_line_periods(steps: Singles, most: float = np.inf) -> Iterator[Floats]:
    """The basis (2, 2) [px] of two families of lines on steps (h, w), if there are two, at most
    `most` [px] apart.
    """
    size = min(_WINDOW, *steps.shape) // 2 * 2
    if size < 8 * _SHORTEST:
        return
    spectrum = _whitened_log_power(steps, size)
    found: list[Floats] = []
    for degrees, row in _find_rays(spectrum):
        angle = np.radians(degrees)
        direction = np.array([np.cos(angle), np.sin(angle)])
        families = []
        for bin_ in _find_combs(row, size, size / most):
            family = LineFamily.follow(steps, direction * bin_ / size)
            if family.contrast > _LEAST_CONTRAST:
                families.append(family)
        if families:
            found.append(max(families, key=lambda one: one.height * one.contrast).frequency)
        if len(found) == 2:
            yield reduce_basis(np.linalg.inv(np.array(found)).T)
            return


@dataclass(frozen=True)
class LineFamily:
    """A family of parallel lines that was followed through all parts of a flat."""

    frequency: Floats  # (2,) [cycles per px]
    border: float  # fractional coordinate 0..1 of the lines, at the pixel (0, 0)
    contrast: float  # of the profile over the whole flat
    height: float  # mean height in the half of the parts where it is lowest [local deviations]
    half_difference: float  # [px] RMS distance of the lines of two halves of the parts

    @classmethod
    def follow(cls, steps: Singles, frequency: Floats) -> LineFamily:
        """Lines on steps (h, w) near a `frequency`, refined by how they drift from part to part.

        A strong detail of the scene repeats in some neighbours only, borders in all parts.
        """
        profile = LineProfile.measure(steps, frequency)
        border = profile.strongest
        size = max(steps.shape)
        rows = np.linspace(0, steps.shape[0], _PARTS + 1).astype(int)
        columns = np.linspace(0, steps.shape[1], _PARTS + 1).astype(int)
        measured = []
        for top, bottom in pairwise(rows.tolist()):
            for left, right in pairwise(columns.tolist()):
                part = LineProfile.measure(steps[top:bottom, left:right], frequency)
                drift, height = part.find_line(border - (left * frequency[0] + top * frequency[1]))
                middle = np.array([left + right, top + bottom]) / (2 * size)
                measured.append((1.0, *middle, drift, max(height, 0.0)))
        table = np.array(measured)
        design = table[:, :3]
        drifts = table[:, 3]
        heights = table[:, 4]
        # Without steps on the lines, drifts are chance.
        weight = heights**2
        change = _fit_plane(design, drifts, weight)
        parity = np.arange(len(table)) % 2
        halves = [_fit_plane(design, drifts, weight * (parity == side)) for side in (0, 1)]
        differ = field_rms(design, (halves[0] - halves[1])[:, None])
        refined = frequency - change[1:] / size
        whole = LineProfile.measure(steps, refined)
        return cls(
            refined,
            whole.find_line(border + float(change[0]))[0] + border + float(change[0]),
            whole.contrast(whole.strongest),
            float(np.sort(heights)[: len(heights) // 2].mean()),
            differ * whole.period,
        )


def fit_touching_cells(steps: Singles, basis: Floats) -> HarmonicFit:
    """Lattice of cells that touch each other, from the lines between them on steps (h, w).

    `basis` (2, 2) [px] is right to a hundredth; the lines of each family are followed twice.
    """
    families = []
    for frequency in np.linalg.inv(basis).T:
        first = LineFamily.follow(steps, frequency)
        families.append(LineFamily.follow(steps, first.frequency))
    frequencies = np.array([one.frequency for one in families])
    centre = np.array([one.border + 0.5 for one in families])
    fitted = np.linalg.inv(frequencies).T
    apart = float(np.linalg.norm([one.half_difference for one in families]))
    return HarmonicFit(centre @ fitted, fitted, apart)


def _fit_plane(design: Floats, values: Floats, weight: Floats) -> Floats:
    """(k,) coefficients of the weighted least squares fit of values (n,) by `design` (n, k)."""
    found: Any = np.linalg.lstsq(design * weight[:, None], values * weight, rcond=None)[0]
    return np.asarray(found)


def _whitened_log_power(steps: Singles, size: int) -> Singles:
    """(size, size // 2 + 1) log power over its local mean, of windows in the middle and corners.

    Row size // 2 is zero frequency.
    """
    height, width = steps.shape
    taper = np.hanning(size).astype(np.float32)
    mean = np.float32(steps.mean())
    corners = {(y, x) for y in (0, height - size) for x in (0, width - size)}
    power = np.zeros((size, size // 2 + 1), np.float32)
    for y, x in sorted(corners | {((height - size) // 2, (width - size) // 2)}):
        window = (steps[y : y + size, x : x + size] - mean) * taper[:, None] * taper
        power += np.abs(np.fft.rfft2(window)) ** 2
    power = np.fft.fftshift(power, axes=0)
    # The half plane is mirrored across zero frequency, so that it has no edge there.
    side = min(_BACKGROUND, size // 4 * 2 - 1)
    mirrored = np.roll(power[::-1, side - 1 : 0 : -1], 1, axis=0)
    background = cv2.blur(np.hstack([mirrored, power]), (side, side))[:, side - 1 :]
    whitened: Singles = np.log(np.maximum(power / background, np.float32(0.05)))
    return whitened


def _find_rays(spectrum: Singles) -> Iterator[tuple[float, Floats]]:
    """Directions [degrees] of the rays with most energy, and the log power along each, at every
    quarter of a bin from zero frequency on.
    """
    size = len(spectrum)
    radius = np.arange(0, 0.47 * size, 0.25)
    # Neighbouring rays are one bin apart at their ends.
    degrees = np.arange(0, 180, np.degrees(1.5 / size))
    angle = np.radians(degrees)[:, None]
    x = np.cos(angle) * radius
    y = np.sin(angle) * radius
    turned = np.where(x < 0, -1, 1)
    rays: Any = cv2.remap(
        spectrum,
        (x * turned).astype(np.float32),
        (y * turned + size // 2).astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
    )
    total = np.maximum(rays[:, 16:], 0).sum(1)
    usual = np.median(total)
    energy = (total - usual) / (1.4826 * np.median(np.abs(total - usual)) + 1e-9)
    while energy.max() > _CLEAR_RAY:
        best = int(energy.argmax())
        row = rays[max(best - 1, 0) : best + 2].max(0).astype(np.float64)
        yield float(degrees[best]), row - np.median(row)
        apart = np.abs((degrees - degrees[best] + 90) % 180 - 90)
        energy[apart < _LEAST_ANGLE] = -1


def _find_combs(row: Floats, size: int, least: float) -> list[float]:
    """Fundamental frequencies [bins] of the strongest combs on a ray, from `least` on.

    A fraction of the true frequency has as many peaks among more places; a multiple has fewer.
    """
    places = np.arange(len(row))
    fundamental = np.exp(np.arange(np.log(5), np.log(size / _SHORTEST), 0.5 / size))
    order = np.arange(1, 49)[:, None]
    place = 4 * fundamental * order
    inside = place < len(row) - 1
    value = np.interp(np.minimum(place, len(row) - 1), places, row) * inside
    score = value.sum(0) / np.sqrt(np.maximum(inside.sum(0), 1))
    found = []
    for _ in range(_PERIODS):
        best = int(score.argmax())
        if score[best] <= 0:
            break
        if fundamental[best] >= least:
            found.append(float(fundamental[best]))
        score[np.abs(fundamental / fundamental[best] - 1) < 0.02] = 0
    return found
