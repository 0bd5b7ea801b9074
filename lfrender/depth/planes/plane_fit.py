"""A plane of the scene: the patch size of all lenses from three numbers, where what they measure proves it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ...flat.lens_graph import count_connected
from ...runtime.normal_equations import solve_cholesky
from ...runtime.quantiles import median

__all__ = ["MIN_TEXTURED_SHARE", "Plane", "fit_plane", "has_outlier_cluster", "is_nearly_planar"]

# Share of the lenses that must clearly carry texture, and of those that must lie on the plane.
MIN_TEXTURED_SHARE, _ON_PLANE = 0.5, 0.9
# Patch sizes [share of the pitch] between which neither shading nor missing overlap can play a part.
_NEAREST_ZERO, _LARGEST = 0.1, 0.7
# A smooth surface of this degree through the lenses may leave the plane by this much [px]: half of what regularity may
# cost.
_DEGREE, _EVEN = 3, 0.025
# A term of it that is so little beside those before it, as of lenses in one line, is left out.
_NOTHING_NEW = 1e-6
# A plane is slanted where that explains so many times the variance of an independent measurement: by chance, one in
# two hundred thousand is.
_TILTED = 25.0
# Least scatter [px] of lenses about a plane: what interpolation does to each of them.
_FLOOR = 0.006
# Systematic error of a patch size [px] that no number of lenses averages out, what it grows by [pitches] with the cube
# of |s| / D, as neighbours come to share no more than their rims, and the share of what misleads the pairs of each lens
# that all lenses of a plane have in common: as measured on 188 planes of random cameras, and those of two ray tracers.
_UNSEEN, _UNSEEN_GROWTH, _COMMON = 0.0014, 0.0003, 0.4
# No slant is read from less than this [px], or as if more than one of so many measurements told something new: pairs in
# opposite directions see the same texture, and each belongs to two lenses.
_CROOKED, _SHARED = 0.0032, 4
# Lenses on the plane are at most so many times the scatter away from it.
_OUTLYING = 4.0
# A lens strays from the plane by more than so many of its standard errors, and this much [px]; it and so many others
# beside it on the same side are a surface of their own: fewer are noise.
_SURE, _OFF, _TOGETHER = 4.0, 0.1, 3
# A round that moves no lens by more than this [px] was the last.
_ROUNDS, _SETTLED = 8, 1e-4
# Nearly on a plane is what is no farther from it than this share of the pitch; this share of the lenses must be.
_NEARLY, _MOST_NEARLY = 0.06, 0.85
# So many lenses tell that there is no plane, where they leave it by so many standard deviations of a smooth surface;
# all of them together need only the second number.
_FEW, _NO_CHANCE, _UNCERTAIN = 300, 5.0, 2.0


@dataclass(frozen=True)
class Plane:
    """A plane of the scene, over which 1 / s is linear in the scene coordinates, like any inverse depth.

    Parameters
    ----------
    inverse : (float, float, float)
        `1 / s` [1/px] at `X = (0, 0)`, and its change per px of `X`, order `x, y`.
    scatter : float [px]
        Of the patch sizes of single lenses about it.
    covariance : (3, 3) float64
        Of `inverse`.
    pitch : float [px]
    misled : float [px]
        What the texture that its matches leave unexplained may have done to each lens.
    tilt : float
        How many times the variance of an independent measurement a slant would explain of what the plane leaves.
    """

    inverse: NDArray[np.float64]
    scatter: float
    covariance: NDArray[np.float64]
    pitch: float
    systematic_error: float = 0.0
    tilt: float = 0.0

    @property
    def slanted(self) -> bool:
        """It does not face the camera."""
        return bool(self.inverse[1:].any())

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) patch size [px] at scene points (n, 2)."""
        return 1 / (self.inverse[0] + points[:, 0] * self.inverse[1] + points[:, 1] * self.inverse[2])

    def over_grid(self, shape: tuple[int, int], first: tuple[float, float], spacing: float) -> NDArray[np.float32]:
        """(h, w) float32 [px] at a regular grid of scene points from `first` on."""
        out = np.empty(shape, np.float32)
        _over_grid(np.asarray(self.inverse, np.float64), *first, spacing, out)
        return out

    def standard_error(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) standard error [px] of `at`."""
        x, y = points.T
        c = self.covariance
        variance = c[0, 0] + x * (2 * c[0, 1] + c[1, 1] * x + 2 * c[1, 2] * y) + y * (2 * c[0, 2] + c[2, 2] * y)
        size2 = self.at(points) ** 2
        shared = np.hypot(_UNSEEN, _UNSEEN_GROWTH * size2 * np.sqrt(size2) / self.pitch**2)
        return np.hypot(np.hypot(shared, _COMMON * self.systematic_error), size2 * np.sqrt(np.maximum(variance, 0)))


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _over_grid(inverse, left, top, spacing, out):
    for v in prange(out.shape[0]):
        row = out[v]
        start = inverse[0] + inverse[1] * left + inverse[2] * (top + spacing * v)
        for u in range(len(row)):
            row[u] = 1 / (start + inverse[1] * spacing * u)


def fit_plane(
    points: NDArray[np.float64], sizes: NDArray[np.float64], pitch: float, facing: bool = False
) -> Plane | None:
    """The plane that lenses lie on: one facing the camera, else a slanted one; None where they do not.

    Parameters
    ----------
    points : (m, 2) float64 [px]
        Centres of lenses, spread over the flat.
    sizes : (m,) float64 [px]
        Patch sizes that they have measured.
    pitch : float [px]
    facing : bool
        Only a plane that faces the camera, or nearly so, will do.
    """
    # Without a common middle and scale the sums of large coordinates would lose digits.
    middle, reach = points.mean(0), float(np.abs(points - points.mean(0)).max()) + 1e-9
    places = (points - middle) / reach
    terms = np.stack([np.ones(len(sizes)), *places.T], 1)
    every = len(sizes) // _FEW
    some = slice(None, None, max(1, every))
    level: Plane | None = None
    for count in (1,) if facing else (1, 3):
        if every > 1 and _hopeless(places[some], terms[some, :count], sizes[some]):
            continue
        inverse = _inverse(terms[:, :count], sizes)
        predicted = 1 / (terms[:, :count] @ inverse)
        size = np.abs(predicted)
        within = (_NEAREST_ZERO * pitch < size).all() and (size < _LARGEST * pitch).all()
        if not within or np.ptp(np.sign(predicted)) > 0:
            continue
        scatter = _even(places, sizes - predicted)
        if scatter is not None:
            # In terms of the coordinates themselves.
            change = np.zeros((3, 3))
            change[0, 0] = 1
            change[0, 1:] = -middle / reach
            change[[1, 2], [1, 2]] = 1 / reach
            change = change[:, :count]
            weight = np.einsum("ni,nj,n->ij", terms[:, :count], terms[:, :count], predicted**4)
            covariance = scatter**2 * np.linalg.inv(weight)
            plane = Plane(change @ inverse, scatter, change @ covariance @ change.T, pitch)
            if count > 1 or facing:
                return plane
            level = replace(plane, tilt=_tilt(places, sizes - predicted, scatter))
            if level.tilt < _TILTED:
                return level
    return level


def is_nearly_planar(places: NDArray[np.float64], sizes: NDArray[np.float64], pitch: float) -> bool:
    """Whether lenses at `places` (m, 2) that were searched to whole pixels may lie on one plane, most of them.

    Of planes at 14 to 35 px pitch 93 % and more do, of scenes with several depths at most 75 %.
    """
    terms = np.column_stack([np.ones(len(sizes)), (places - places.mean(0)) / (np.ptp(places) + 1e-9)])
    with np.errstate(divide="ignore", invalid="ignore"):
        away = np.abs(sizes - 1 / (terms @ _inverse(terms, sizes, doubted=True)))
    return bool((away <= _NEARLY * pitch).mean() >= _MOST_NEARLY)


def _hopeless(places: NDArray[np.float64], terms: NDArray[np.float64], sizes: NDArray[np.float64]) -> bool:
    """Whether a few lenses already leave the best plane farther than chance could make them."""
    return _even(places, sizes - 1 / (terms @ _inverse(terms, sizes, _ROUNDS // 2)), _NO_CHANCE) is None


# One sum after the other: what vector loops or threads add in another order would have other bits.
@njit(cache=True, nogil=True, error_model="numpy")
def _fitted(rows, sizes, rounds, doubted):
    """`_inverse` for terms (k, n), k at most 3."""
    count, number = rows.shape
    inverse, left, right = np.zeros(count), np.empty((count, count)), np.empty(count)
    middle = np.median(sizes)
    inverse[0] = 1 / middle
    residual = sizes - middle
    for turn in range(rounds):
        weighed = turn > 0 or count == 1 or doubted
        limit = _OUTLYING * max(1.48 * np.median(np.abs(residual)), _FLOOR) if weighed else np.inf
        left[:], right[:] = 0.0, 0.0
        for n in range(number):
            s = sizes[n]
            away = residual[n] / limit
            share = 1 / (1 + away * away)
            # An error of s is s^2 times that of 1 / s.
            w = share * share * (s * s) * (s * s)
            for i in range(count):
                right[i] += w * rows[i, n] / s
                for j in range(i + 1):
                    left[i, j] += w * rows[i, n] * rows[j, n]
        solve_cholesky(left, right, inverse)
        change = 0.0
        for n in range(number):
            told = inverse[0] * rows[0, n]
            for i in range(1, count):
                told += inverse[i] * rows[i, n]
            after = sizes[n] - 1 / told
            change = max(change, abs(after - residual[n]))
            residual[n] = after
        if change < _SETTLED:
            break
    return inverse


def _inverse(
    terms: NDArray[np.float64], sizes: NDArray[np.float64], rounds: int = _ROUNDS, doubted: bool = False
) -> NDArray[np.float64]:
    """(k,) robust linear fit to 1 / s, every lens with the same error of s (weights after Geman and McClure).

    What is `doubted` must be near the median to count at first.
    """
    return _fitted(np.ascontiguousarray(terms.T), np.ascontiguousarray(sizes), rounds, doubted)


def _even(places: NDArray[np.float64], residual: NDArray[np.float64], deviations: float = _UNCERTAIN) -> float | None:
    """Scatter [px] of lenses about a plane; None where too few lie on it, or a smooth surface leaves it."""
    scatter = 1.48 * median(np.abs(residual))
    inside = np.abs(residual) < _OUTLYING * max(scatter, _FLOOR)
    if not inside.mean() > _ON_PLANE:
        return None
    leaves = _leaves(places[inside], residual[inside], deviations * scatter)
    return None if leaves else scatter


def _tilt(places: NDArray[np.float64], residual: NDArray[np.float64], scatter: float) -> float:
    """How many times the variance of an independent measurement a slant explains of the residuals of a plane that faces
    the camera; 0 where systematic errors explain as much."""
    inside = np.abs(residual) < _OUTLYING * max(scatter, _FLOOR)
    away, left = places[inside] - places[inside].mean(0), residual[inside] - residual[inside].mean()
    square, pull = away.T @ away, away.T @ left
    explained = float(pull @ np.linalg.lstsq(square, pull, rcond=_NOTHING_NEW)[0])
    systematic = len(left) * _CROOKED**2
    return explained / (_SHARED * max(scatter, 1e-9) ** 2) if explained > systematic else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _leaves(places, residual, deviation):
    """Whether a smooth surface of degree `_DEGREE` through the residuals is anywhere farther from zero than `_EVEN`,
    and than the scatter leaves uncertain."""
    count = (_DEGREE + 1) * (_DEGREE + 2) // 2
    terms = np.empty((count, len(places)))
    value, uncertain = np.zeros(len(places)), np.zeros(len(places))
    found = 0
    for i in range(_DEGREE + 1):
        for j in range(_DEGREE + 1 - i):
            term = terms[found]
            for n in range(len(places)):
                term[n] = places[n, 0] ** i * places[n, 1] ** j
            whole = np.sqrt((term * term).sum())
            # Each term is freed of those before it, twice: once leaves what rounding does.
            for _ in range(2):
                for k in range(found):
                    shared = (term * terms[k]).sum()
                    for n in range(len(places)):
                        term[n] -= shared * terms[k, n]
            own = np.sqrt((term * term).sum())
            if own <= _NOTHING_NEW * whole:
                continue
            term /= own
            factor = (term * residual).sum()
            for n in range(len(places)):
                value[n] += factor * term[n]
                uncertain[n] += term[n] * term[n]
            found += 1
    # What the scatter of single lenses leaves uncertain about that surface is not held against the plane.
    return bool((np.abs(value) > _EVEN + deviation * np.sqrt(uncertain)).any())


def has_outlier_cluster(residual: NDArray[np.float64], errors: NDArray[np.float64], rows: NDArray[np.int32]) -> bool:
    """Whether lenses beside each other leave the plane to one side.

    Parameters
    ----------
    residual, errors : (n,) float [px]
        Distance of each lens from the plane and its standard error; inf or NaN where not known.
    rows : (n, k) int32
        Neighbour rows, -1 where there is none.
    """
    with np.errstate(invalid="ignore"):
        off = np.abs(residual) > np.maximum(_OFF, _SURE * errors)
        return any((count_connected(off & (side * residual > 0), rows) >= _TOGETHER).any() for side in (-1, 1))
