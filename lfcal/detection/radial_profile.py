"""Radial profile that all microimages have in common, and the lattice by which they agree with it best.

The shift that makes a microimage agree better with the profile is a Gauss-Newton step for that lens; the lattice is
fitted to the steps of all lenses by robust least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..lattice.cell import cell_inradius, cell_normals, is_outside_cell
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import StackedCrops, select_whole_lenses
from ..lattice.lit_lenses import find_lit_lenses
from ..lattice.robust_fit import TUKEY_CUTOFF, LatticeFit, field_rms, fit_lattice_shifts, shift_standard_error
from ..runtime.errors import CalibrationError
from ..runtime.kernels.jit import kernel
from .settings import DEFAULT, ProfileSettings

__all__ = ["RadialProfile", "fit_lattice", "measure_radial_profile"]

_CHUNKS = 64


@kernel(share=lambda picture, centres, faces, inner, reach, step, chunks, *_: chunks)
def _accumulate_profile(begin, end, picture, centres, faces, inner, reach, step, chunks, total, square, count):
    """Sums over the distance to the centre; chunks of fixed size, so that the number of threads changes no bit."""
    lenses = centres.shape[0]
    for chunk in range(begin, end):
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


@kernel(share=lambda picture, centres, *_: len(centres))
def _accumulate_equations(
    begin, end, picture, centres, faces, inner, first, reach, step, level, slope, weight, cutoff, normal, right
):
    """Normal equations of the shift of each lens, from the ring between `first` and `reach`."""
    for lens in range(begin, end):
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
        normal[lens, 0, 0], normal[lens, 0, 1], normal[lens, 1, 0], normal[lens, 1, 1] = xx, xy, xy, yy
        right[lens, 0], right[lens, 1] = bx, by


@dataclass(frozen=True)
class RadialProfile:
    """Mean and variance of a picture over the distance to the nearest microimage centre."""

    mean: NDArray[np.float64]  # (k,) at radii `0, step, 2*step, ...`
    variance: NDArray[np.float64]  # (k,)
    weight: NDArray[np.float64]  # (k,) number of pixels
    step: float  # [px]

    @property
    def slope(self) -> NDArray[np.float64]:
        """(k,) derivative of the mean [1/px]."""
        return np.gradient(self.mean, self.step)


def measure_radial_profile(
    picture: NDArray[np.float32] | StackedCrops,
    lattice: Lattice,
    lenses: int = 1000,
    light: NDArray[np.float32] | None = None,
    settings: ProfileSettings = DEFAULT.profile,
) -> RadialProfile:
    """Average microimages over whole cells of the lattice, as a function of the distance to the centre.

    Parameters
    ----------
    picture : (h, w) float32, or crops
    lattice : Lattice [px]
    lenses : int
        About so many, evenly spread.
    light : (h, w) float32, optional
        Luminance of the flat or of its crops: lenses that are dark on it are left out.
    """
    crops = StackedCrops.of(picture)
    normals, reach = cell_normals(lattice)
    indices, centres, crop = crops.lenses(lattice, reach + 1)
    places = centres - crops.offsets[crop]
    if light is not None:
        places = places[find_lit_lenses(light, lattice, indices, places, settings.dark_lens)]
    places = np.ascontiguousarray(places[:: max(1, len(places) // lenses)])
    step, inner = settings.step, cell_inradius(normals)
    rings = int(reach / step) + 3
    total, square, count = (np.zeros((_CHUNKS, rings)) for _ in range(3))
    _accumulate_profile(crops.picture, places, normals, inner, reach, step, _CHUNKS, total, square, count)
    summed, squares, number = total.sum(0), square.sum(0), count.sum(0)
    filled = number > 1e-6
    if filled.sum() < 2:
        return RadialProfile(np.zeros(rings), np.ones(rings), np.zeros(rings), step)
    at = np.arange(rings)
    mean = np.interp(at, at[filled], summed[filled] / number[filled])
    variance = np.interp(at, at[filled], squares[filled] / number[filled]) - mean**2
    floor = 1e-4 * float(np.var(mean)) + 1e-12
    return RadialProfile(mean, np.maximum(variance, floor), number, step)


def fit_lattice(
    picture: NDArray[np.float32], lattice: Lattice, passes: int = 3, settings: ProfileSettings = DEFAULT.profile
) -> LatticeFit:
    """Fit origin and basis to all whole microimages of a small picture.

    Parameters
    ----------
    picture : (h, w) float32
        The same function of the distance to the centre in all microimages.
    lattice : Lattice [px]
        Start, right to a fraction of the pitch over the whole flat.
    passes : int
        Most Gauss-Newton steps; fewer are taken when nothing moves any more.

    Raises
    ------
    CalibrationError
        If fewer than a dozen whole microimages are on the flat, or the fit diverges.
    """
    start = lattice
    for _ in range(passes):
        indices, normal, right = _lens_equations(picture, lattice, settings)
        design = np.column_stack([np.ones(len(indices)), indices])
        change, residuals, weight, variance = fit_lattice_shifts(design, normal, right)
        lattice = Lattice(lattice.origin + change[0], lattice.basis + change[1:], start.image_size, start.radius)
        if not np.abs(lattice.basis @ np.linalg.inv(start.basis) - np.eye(2)).max() < settings.max_change:
            raise CalibrationError("the microimages do not keep to one lattice; give a sharper flat or a white image")
        error = shift_standard_error(design, normal, weight, variance)
        if field_rms(design, change) < settings.settled * error:
            break
    residual_rms = float(np.sqrt(np.average((residuals**2).sum(1), weights=weight)))
    first, second = (fit_lattice_shifts(design[k::2], normal[k::2], right[k::2])[0] for k in (0, 1))
    half_difference = field_rms(design, first - second)
    return LatticeFit(lattice.origin, lattice.basis, residual_rms, error, int((weight > 0).sum()), half_difference)


def _lens_equations(
    picture: NDArray[np.float32], lattice: Lattice, settings: ProfileSettings
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Indices (n, 2), normal matrices (n, 2, 2) and right sides (n, 2) of the shift of each whole lens."""
    normals, reach = cell_normals(lattice)
    indices, centres = select_whole_lenses(lattice, reach + 1)
    centres = np.ascontiguousarray(centres)
    if len(centres) < settings.fewest_lenses:
        raise CalibrationError(
            f"only {len(centres)} whole microimages of {lattice.pitch:.1f} px pitch fit on the flat, "
            f"at least {settings.fewest_lenses} are needed; give the whole sensor"
        )
    normal, right = np.zeros((len(centres), 2, 2)), np.zeros((len(centres), 2))
    profile = measure_radial_profile(picture, lattice, settings=settings)
    slope = profile.slope
    # Pixels near the middle carry next to no information on the centre.
    information = np.cumsum(profile.weight * slope**2 / profile.variance)
    spared = int(np.searchsorted(information, settings.spare * information[-1]))
    first = max(1.0, (spared - 1) * profile.step)
    _accumulate_equations(
        picture, centres, normals, cell_inradius(normals), first, reach, profile.step, profile.mean, slope,
        1 / profile.variance, TUKEY_CUTOFF, normal, right,
    )  # fmt: skip
    return indices, normal, right
