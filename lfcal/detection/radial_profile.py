"""Global fit: one lattice through all microimages at once, every pixel of which votes.

Each microimage is compared with the radial profile that all of them have in common; the shift that would make it
agree better is a Gauss-Newton step for that lens. Steps of all lenses are pooled, robustly, into the six
parameters of the lattice: two of the origin, four of the basis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ..lattice.cell import cell_inradius, cell_normals, is_outside_cell
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops, select_whole_lenses
from ..lattice.lit_lenses import find_lit_lenses
from ..lattice.robust_fit import TUKEY_CUTOFF, LatticeFit, field_rms, fit_lattice_shifts, shift_standard_error
from ..runtime.errors import CalibrationError

__all__ = ["RadialProfile", "fit_lattice", "measure_radial_profile"]

# Distance between samples of a radial profile [px]: edges of discs are about one pixel wide.
_STEP = 0.25
_CHUNKS = 64
# Share of the information on the centre that may be left out to save pixels.
_SPARE = 0.02
# The first steps need only so many lenses, and move by more than the rest can correct.
_SKETCH_LENSES = 500
_SKETCH_PASSES = 3
_FEWEST_LENSES = 12
# Steps below this share of the standard error change nothing.
_SETTLED = 0.3
_RUNAWAY = 0.05
_GOLDEN = 0.6180339887498949
# A lens with less than this share of the light of a bright one is dark; noise at 26 dB makes up a third of it.
_DARK = 0.1


@njit(cache=True, nogil=True, parallel=True)
def _accumulate_profile(picture, centres, faces, inner, reach, step, chunks, total, square, count):
    lenses = centres.shape[0]
    for chunk in prange(chunks):
        for lens in range(chunk * lenses // chunks, (chunk + 1) * lenses // chunks):
            cx, cy = centres[lens, 0], centres[lens, 1]
            for y in range(int(np.ceil(cy - reach)), int(np.floor(cy + reach)) + 1):
                dy = y - cy
                half = np.sqrt(max(reach * reach - dy * dy, 0.0))
                for x in range(int(np.ceil(cx - half)), int(np.floor(cx + half)) + 1):
                    dx = x - cx
                    rho = np.sqrt(dx * dx + dy * dy)
                    if rho > inner and is_outside_cell(dx, dy, faces):
                        continue
                    place = rho / step
                    ring = int(place)
                    part = place - ring
                    value = picture[y, x]
                    total[chunk, ring] += value * (1 - part)
                    total[chunk, ring + 1] += value * part
                    square[chunk, ring] += value * value * (1 - part)
                    square[chunk, ring + 1] += value * value * part
                    count[chunk, ring] += 1 - part
                    count[chunk, ring + 1] += part


@njit(cache=True, nogil=True, parallel=True)
def _accumulate_steps(picture, centres, faces, inner, first, reach, step, level, slope, weight, cutoff, normal, right):
    for lens in prange(centres.shape[0]):
        cx, cy = centres[lens, 0], centres[lens, 1]
        xx = xy = yy = bx = by = 0.0
        for y in range(int(np.ceil(cy - reach)), int(np.floor(cy + reach)) + 1):
            dy = y - cy
            half = np.sqrt(max(reach * reach - dy * dy, 0.0))
            start, stop = int(np.ceil(cx - half)), int(np.floor(cx + half)) + 1
            left = right_side = stop
            if abs(dy) < first:
                hole = np.sqrt(first * first - dy * dy)
                left, right_side = int(np.ceil(cx - hole)), int(np.floor(cx + hole)) + 1
            for side in range(2):
                low, high = (start, min(left, stop)) if side == 0 else (max(right_side, start), stop)
                for x in range(low, high):
                    dx = x - cx
                    rho = np.sqrt(dx * dx + dy * dy)
                    if rho > inner and is_outside_cell(dx, dy, faces):
                        continue
                    place = rho / step
                    ring = int(place)
                    part = place - ring
                    w = weight[ring] * (1 - part) + weight[ring + 1] * part
                    residual = picture[y, x] - (level[ring] * (1 - part) + level[ring + 1] * part)
                    far = residual * residual * w / (cutoff * cutoff)
                    if far >= 1:
                        continue
                    w *= (1 - far) * (1 - far)
                    g = -(slope[ring] * (1 - part) + slope[ring + 1] * part) / max(rho, 1e-6)
                    gx, gy = g * dx, g * dy
                    xx += w * gx * gx
                    xy += w * gx * gy
                    yy += w * gy * gy
                    bx += w * gx * residual
                    by += w * gy * residual
        normal[lens, 0, 0] += xx
        normal[lens, 0, 1] += xy
        normal[lens, 1, 0] += xy
        normal[lens, 1, 1] += yy
        right[lens, 0] += bx
        right[lens, 1] += by


@dataclass(frozen=True)
class RadialProfile:
    """Mean and variance of a feature over the distance to the nearest microimage centre.

    Parameters
    ----------
    mean, variance : (k,) float64
        At radii `0, step, 2*step, ...`.
    weight : (k,) float64
        Pixels that took part.
    step : float [px]
    """

    mean: NDArray[np.float64]
    variance: NDArray[np.float64]
    weight: NDArray[np.float64]
    step: float

    @property
    def slope(self) -> NDArray[np.float64]:
        """(k,) derivative of the mean [1/px]."""
        return np.gradient(self.mean, self.step)

    @property
    def first(self) -> float:
        """Radius [px] inside of which pixels say next to nothing about the centre."""
        information = np.cumsum(self.weight * self.slope**2 / self.variance)
        return max(1.0, (int(np.searchsorted(information, _SPARE * information[-1])) - 1) * self.step)


def measure_radial_profile(
    picture: NDArray[np.float32] | StackedCrops,
    lattice: Lattice,
    lenses: int = 1000,
    light: NDArray[np.float32] | None = None,
) -> RadialProfile:
    """Profile of `picture`, (h, w) or parts, over whole cells of the lattice, about so many of them, evenly spread.

    Where `light` (h, w) of the flat or of its parts is given, lenses that are dark on it are left out.
    """
    parts = StackedCrops.of(picture)
    picture = parts.picture
    faces, reach = cell_normals(lattice)
    indices, centres, part = parts.lenses(lattice, reach + 1)
    places = centres - parts.offsets[part]
    if light is not None:
        places = places[find_lit_lenses(light, lattice, indices, places, _DARK)]
    centres = np.ascontiguousarray(places[:: max(1, len(places) // lenses)])
    rings = int(reach / _STEP) + 3
    total, square, count = (np.zeros((_CHUNKS, rings)) for _ in range(3))
    _accumulate_profile(picture, centres, faces, cell_inradius(faces), reach, _STEP, _CHUNKS, total, square, count)
    summed, squares, number = total.sum(0), square.sum(0), count.sum(0)
    filled = number > 1e-6
    if filled.sum() < 2:
        return RadialProfile(np.zeros(rings), np.ones(rings), np.zeros(rings), _STEP)
    at = np.arange(rings)
    mean = np.interp(at, at[filled], summed[filled] / number[filled])
    variance = np.interp(at, at[filled], squares[filled] / number[filled]) - mean**2
    floor = 1e-4 * float(np.var(mean)) + 1e-12
    return RadialProfile(mean, np.maximum(variance, floor), number, _STEP)


def fit_lattice(picture: NDArray[np.float32], lattice: Lattice, passes: int = 3, pixels: float = 6e6) -> LatticeFit:
    """Fit origin and basis to all whole microimages.

    Parameters
    ----------
    picture : (h, w) float32
        A feature that is the same function of the distance to the centre in all microimages.
    lattice : Lattice [px]
        Start, right to a fraction of the pitch over the whole flat.
    passes : int
        Most Gauss-Newton steps; fewer are taken when nothing moves any more.
    pixels : float
        Use only as many lenses, evenly spread, as have so many pixels in all.

    Raises
    ------
    CalibrationError
        If fewer than a dozen whole microimages are on the flat.
    """
    origin: NDArray[Any] = lattice.origin
    basis: NDArray[Any] = lattice.basis
    every = int(np.ceil(lattice.image_size[0] * lattice.image_size[1] / pixels))
    every = max(1, min(every, len(lattice) // _SKETCH_LENSES))
    sketches = _SKETCH_PASSES if len(lattice) > 2 * _SKETCH_LENSES * every else 0
    for turn in range(sketches + passes):
        current = Lattice(origin, basis, lattice.image_size, lattice.radius)
        stride = max(1, len(lattice) // _SKETCH_LENSES) if turn < sketches else every
        indices, normal, right = _lens_steps(picture, current, stride)
        design = np.column_stack([np.ones(len(indices)), indices])
        change, residuals, weight, variance = fit_lattice_shifts(design, normal, right)
        origin = origin + change[0]
        basis = basis + change[1:]
        if not np.abs(basis @ np.linalg.inv(lattice.basis) - np.eye(2)).max() < _RUNAWAY:
            raise CalibrationError("the microimages do not keep to one lattice; give a sharper flat or a white image")
        error = shift_standard_error(design, normal, weight, variance)
        if turn >= sketches and field_rms(design, change) < _SETTLED * error:
            break
    residual_rms = float(np.sqrt(np.average((residuals**2).sum(1), weights=weight)))
    first, second = (fit_lattice_shifts(design[k::2], normal[k::2], right[k::2])[0] for k in (0, 1))
    half_difference = field_rms(design, first - second)
    return LatticeFit(origin, basis, residual_rms, error, int((weight > 0).sum()), half_difference)


def _lens_steps(
    picture: NDArray[np.float32], lattice: Lattice, stride: int
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Indices (n, 2), normal matrices (n, 2, 2) and right sides (n, 2) of the steps of one lens in `stride`."""
    faces, reach = cell_normals(lattice)
    indices, centres = select_whole_lenses(lattice, reach + 1)
    # Multiples of the golden ratio spread the chosen lenses evenly, where every n-th one would favour some columns.
    chosen = np.arange(len(centres)) * _GOLDEN % 1 < 1 / stride
    indices, centres = indices[chosen], np.ascontiguousarray(centres[chosen])
    if len(centres) < _FEWEST_LENSES:
        raise CalibrationError(
            f"only {len(centres)} whole microimages of {lattice.pitch:.1f} px pitch fit on the flat, "
            f"at least {_FEWEST_LENSES} are needed; give the whole sensor"
        )
    normal, right = np.zeros((len(centres), 2, 2)), np.zeros((len(centres), 2))
    profile = measure_radial_profile(picture, lattice)
    _accumulate_steps(
        picture, centres, faces, cell_inradius(faces), profile.first, reach, profile.step, profile.mean, profile.slope,
        1 / profile.variance, TUKEY_CUTOFF, normal, right,
    )  # fmt: skip
    return indices, normal, right
