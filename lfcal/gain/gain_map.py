"""Gain map: relative illumination at every place of every microimage; fits of the light; defects.

The map is compact enough for a camera file.

The light of a lens is its level times the shape of its microimage. The shape is one profile over
the distance to the centre, stretched in each direction to the rim there, cut by a second disc where
the barrel of the main lens does so (cat-eye), and shaded by a low-order polynomial. What changes
over the field is a low-order polynomial of the place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..lattice.cell import Cell
from ..lattice.lattice import Lattice
from ..lattice.robust_fit import TUKEY_CUTOFF, biweight, robust_sigma
from ..runtime.arrays import (
    ENOUGH_LENSES,
    Array,
    Floats,
    Frozen,
    Integers,
    Singles,
    decode_array,
    encode_array,
    evenly,
)
from .kernel import RIM_START, Shape, evaluate_light

__all__ = [
    "BEFORE_RIM",
    "Defects",
    "GainMap",
    "Vignetting",
    "choose_degree",
    "count_terms",
    "field_monomials",
    "first_half",
    "fit_light",
    "fit_light_slope",
    "largest_values",
    "nearest_half",
]

# Lenses that are sampled together, so that memory does not grow with the flat.
_PART = 500
#: Rings with more relative light than this lie inside the middle of the rim.
BEFORE_RIM = 0.75
# Number of lenses, spread over the flat, whose light is averaged; 16 captures have the same lit
# cell with 16, 32 and 64.
_AVERAGED = 16
# Largest values: light over that of the brightest place, or its natural logarithm, which measured
# maps have between -0.3 and 1.1; light of lenses over their polynomial; factors of the shading.
_LARGEST = {
    "profile": 10.0,
    "stray_light": 10.0,
    "type_light": 10.0,
    "level": 10.0,
    "lens_gain": 100.0,
    "shading": 100.0,
}
# Degrees of the polynomial of the light that are tried, and lenses for each of its factors.
_DEGREES = (4, 2)
_LENSES_PER_TERM = 12
# [half diagonal] Step for the slope of the polynomial; with 1e-3 it is right to 1e-6.
_SMALL_STEP = 1e-3


@dataclass(frozen=True, eq=False)
class GainMap(Frozen):
    """Relative illumination: 1 at the brightest place of the brightest part of the field.

    Polynomials of the field have the terms `1, X, Y, X^2, X*Y, Y^2, ...` of the place `(X, Y)` of a
    lens, measured from the middle of the flat in half diagonals.

    Parameters
    ----------
    profile : (k,) float64
        Light over the distance to the centre, at `0, step, 2*step, ...`, of a lens with a round
        uncut rim.
    step : float [px]
    radius : float [px]
        Unit of length of `shading`, and where `rim` applies in full.
    level : (t,) float64
        Polynomial of the natural logarithm of the light of a lens (natural vignetting); `t` = 1, 3,
        6, 10 ...
    lens_gain : (n,) float32
        Light of each lens over that of the polynomial, in the order of `lattice.centres()`; 0 for
        an unlit lens. Empty if all are 1.
    shading : (5, t) float64
        Polynomials of the factors of `u, v, u^2, u*v, v^2` with `(u, v) = delta / radius`; 1 is
        added to their sum.
    rim : (1 + 2*m, t) float64 [px]
        Polynomials of how far the rim lies outside that of `profile`: mean, then cosine and sine of
        each harmonic of the direction.
    cut : (5,) float64 [px]
        Cutting disc: displacement (2) in the middle, displacement added up to the corner, radius,
        standard deviation of its edge. Empty if there is none.
    stray_light : float
        Light outside the cutting disc.
    type_light : (t, k) float64
        Light of each type of lens over that of `profile`, where types differ; else (0, 0).
    type_cell : (m, m) int8
        Lens `(i, j)` is of type `type_cell[i % m, j % m]`; (0, 0) where types do not differ.

    Examples
    --------
    >>> import lfcal, lfrender
    >>> sample = lfrender.data.house(size=(400, 300), samples=2)
    >>> camera = lfcal.calibrate(sample.white, kind="white")
    >>> light = camera.gain()  # of every pixel of the flat, 1 at the brightest
    >>> light.shape, camera.gain_map.step
    ((300, 400), 0.25)
    """

    profile: Floats
    step: float
    radius: float
    level: Floats
    lens_gain: Singles
    shading: Floats
    rim: Floats
    cut: Floats
    stray_light: float = 0.0
    type_light: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    type_cell: NDArray[np.int8] = field(default_factory=lambda: np.zeros((0, 0), np.int8))

    def __post_init__(self) -> None:
        for name, kind, dimensions in (
            ("profile", np.float64, 1),
            ("level", np.float64, 1),
            ("lens_gain", np.float32, 1),
            ("shading", np.float64, 2),
            ("rim", np.float64, 2),
            ("cut", np.float64, 1),
            ("type_light", np.float64, 2),
            ("type_cell", np.int8, 2),
        ):
            values: Array = np.array(getattr(self, name), dtype=kind)
            if values.ndim != dimensions or not np.isfinite(values).all():
                raise ValueError(f"{name} must be a finite array of {dimensions} dimension(s)")
            self._set(**{name: values})
        numbers = {name: float(getattr(self, name)) for name in ("step", "radius", "stray_light")}
        self._set(**numbers)
        if not (np.isfinite(list(numbers.values())).all() and self.step > 0 and self.radius > 0):
            raise ValueError(
                "step and radius of a gain map must be positive numbers of px, stray_light finite"
            )
        sizes = {count_terms(degree) for degree in range(8 + 1)}
        tables = (len(self.level), self.shading.shape[1], self.rim.shape[1])
        if len(self.profile) < 2 or self.shading.shape[0] != 5 or not set(tables) <= sizes:
            raise ValueError("profile, level, shading or rim of a gain map is of a wrong shape")
        if (
            self.rim.shape[0] % 2 != 1
            or len(self.cut) not in (0, 5)
            or (len(self.cut) and not self.cut[4] > 0)
        ):
            raise ValueError("rim or cut of a gain map is of a wrong shape")
        types = self.type_cell
        light = self.type_light
        fits = (
            light.shape == (types.max(initial=-1) + 1, len(self.profile))
            and types.shape[0] == types.shape[1]
        )
        if types.size + light.size and not (fits and types.min(initial=0) == 0 and light.min() > 0):
            raise ValueError("type_light or type_cell of a gain map is of a wrong shape")

    @classmethod
    def round(cls, profile: Any, step: float, radius: float, cut: Any = ()) -> GainMap:
        """A map in which all lenses are equal, with one radial profile."""
        none = np.zeros(0, np.float32)
        return cls(
            profile,
            step,
            radius,
            np.zeros(1),
            none,
            np.zeros((5, 1)),
            np.zeros((1, 1)),
            np.array(cut),
        )

    def limited(self, lattice: Lattice) -> GainMap:
        """The map with all values within those that a camera file may hold."""
        largest = largest_values(lattice)
        return replace(
            self,
            **{name: np.clip(getattr(self, name), -most, most) for name, most in largest.items()},
        )

    def light(self, field: Floats) -> Floats:
        """(n,) light of lenses at places (n, 2) of the field, by the polynomial."""
        return np.exp(field_monomials(field, len(self.level)) @ self.level)

    def describe(self, field: Floats) -> Floats:
        """(n, s) lenses at places (n, 2) of the field as kernels take them: see `kernel`."""
        lenses = np.zeros((len(field), RIM_START + len(self.rim)))
        unit = np.array([1.0, 1, 2, 2, 2])
        shading = field_monomials(field, self.shading.shape[1]) @ self.shading.T
        lenses[:, :5] = shading / self.radius**unit
        if len(self.cut):
            lenses[:, 5:7] = self.cut[:2] + self.cut[2] * field
        rim = field_monomials(field, self.rim.shape[1]) @ self.rim.T
        lenses[:, RIM_START:] = rim / self.radius
        return lenses

    @property
    def shape(self) -> Shape:
        """What all microimages have in common, as kernels take it."""
        cut = np.zeros(6)
        cut[: len(self.cut)] = self.cut
        cut[5] = self.stray_light
        return Shape(self.profile, self.step, cut)

    def usable_radius(self, lattice: Lattice) -> Floats:
        """Largest distance [px] (n,) within which a lens has half its light in all directions.

        It is 0 for unlit lenses.
        """
        limit = nearest_half(lattice)
        lenses = self.describe(lattice.field_place(lattice.centres()))
        least = np.full(len(lattice), limit)
        # In parts, so that memory does not grow with the flat.
        for part in np.array_split(np.arange(len(lenses)), len(lenses) // _PART + 1):
            light = self.sample(lenses[part], int(limit / self.step) + 2)
            least[part] = first_half(light, self.step, limit).min(1)
        if len(self.lens_gain):
            return np.where(self.lens_gain == 0, 0, least)
        return least

    def lit_cell(self, lattice: Lattice) -> float:
        """Factor 0..1 by which the cell of a lens is scaled so that it holds half the light.

        It is 1 if microimages fill their cells, and below 1 / sqrt(2) for discs in square cells.
        """
        cell = Cell.of(lattice)
        centres = lattice.centres()
        chosen = lattice.field_place(centres[:: max(1, len(centres) // _AVERAGED)])
        rings = int(cell.circumradius / self.step) + 2
        light = self.sample(self.describe(chosen), rings).mean(0)
        inner = light[:, : int(cell.inradius / 2 / self.step) + 1]
        reach = first_half(light / inner.max(), self.step, cell.circumradius)
        angle = np.arange(len(light)) * (2 * np.pi / len(light))
        directions = np.column_stack([np.cos(angle), np.sin(angle)])
        border = 0.5 / (directions @ cell.normals.T).max(1)
        return float(np.clip(reach / border, 0, 1).min())

    def evaluate(self, lenses: Floats, lens: Integers, x: Any, y: Any) -> Floats:
        """Evaluate the map at places `x, y` (p,) [px] from the centres of described lenses.

        `lens` (p,) are rows of the description. The result (3, p) is that of `relative_light`.

        Relative light, distance on the profile [px], share that the cutting disc leaves.
        """
        out = np.empty((3, len(lens)))
        evaluate_light(lens, x, y, lenses, self.shape, out)
        return out

    def sample(self, lenses: Floats, rings: int) -> Floats:
        """(n, 32, rings) light of described lenses in 32 directions at distances `0, step, ...`."""
        lens, direction, ring = np.indices((len(lenses), 32, rings)).reshape(3, -1)
        angle = direction * (2 * np.pi / 32)
        x, y = (ring * self.step * wave for wave in (np.cos(angle), np.sin(angle)))
        return self.evaluate(lenses, lens, x, y)[0].reshape(-1, 32, rings)

    @property
    def profiles(self) -> Floats:
        """(t, k) profile of each type of lens; (1, k) where they do not differ."""
        profiles = self.profile * self.type_light if self.type_light.size else self.profile[None]
        # Read-only like the profile: for writable arrays, kernels would be compiled anew.
        profiles.flags.writeable = False
        return profiles

    def type_rims(self, radius: float) -> Floats:
        """Values of `type_light` (t, k) within `radius` [px], before the middle of the rim."""
        inside = (np.arange(len(self.profile)) * self.step < radius) & (self.profile > BEFORE_RIM)
        return self.type_light[:, inside]

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and strings; `profile` and `lens_gain` as encoded arrays."""
        light = encode_array(self.type_light.astype("<f4"))
        cell = self.type_cell.tolist()
        return {
            "profile": encode_array(self.profile.astype("<f4")),
            "step": self.step,
            "radius": self.radius,
            "level": self.level.tolist(),
            "own": encode_array(self.lens_gain.astype("<f2")),
            "shade": self.shading.tolist(),
            "rim": self.rim.tolist(),
            "cut": self.cut.tolist(),
            "dark": self.stray_light,
            "types": {"cell": cell, "light": light} if self.type_light.size else None,
        }

    @classmethod
    def from_dict(cls, data: Any) -> GainMap:
        """Inverse of `to_dict`; KeyError, TypeError or ValueError if `data` is malformed."""
        profile = decode_array(data["profile"], "<f4")
        types = data.get("types")
        cell = np.array(types["cell"] if types else np.zeros((0, 0)))
        light = (
            decode_array(types["light"], "<f4").reshape(-1, len(profile))
            if types
            else np.zeros((0, 0))
        )
        return cls(
            profile,
            data["step"],
            data["radius"],
            data["level"],
            decode_array(data["own"], "<f2"),
            data["shade"],
            data["rim"],
            data["cut"],
            data["dark"],
            light,
            cell,
        )


@dataclass(frozen=True, eq=False)
class Vignetting(Frozen):
    """Relative illumination over the microimage radius, 1 in the middle.

    Parameters
    ----------
    profile : (k,) float64
        Relative illumination at radii `0, step, 2*step, ...`; above 1 where neighbours add light.
    step : float [px]
        Distance between samples of `profile`.

    Examples
    --------
    >>> Vignetting([1.0, 0.9, 0.5], step=2.0).at([1.0, 3.0])
    array([0.95, 0.7 ])
    """

    profile: Floats
    step: float

    def __post_init__(self) -> None:
        profile = np.array(self.profile, dtype=np.float64)
        if profile.ndim != 1 or len(profile) < 2 or not np.isfinite(profile).all():
            raise ValueError("profile must be a finite 1D array with at least two samples")
        if not (np.isfinite(self.step) and self.step > 0):
            raise ValueError(f"step must be a positive number of px, got {self.step!r}")
        self._set(profile=profile, step=float(self.step))

    def at(self, radius: ArrayLike) -> Floats:
        """Relative illumination at distances `radius` [px] from the microimage centre."""
        return np.interp(
            np.asarray(radius, dtype=np.float64),
            np.arange(len(self.profile)) * self.step,
            self.profile,
        )


@dataclass(frozen=True, eq=False)
class Defects(Frozen):
    """Unreliable pixels and lenses of a flat.

    Parameters
    ----------
    pixels : (k, 2) int32
        `x, y` of pixels that are hot, dead or under dust or scratches.
    lenses : (m, 2) int32
        Lattice indices `i, j` of lenses that are missing or unlit.

    Examples
    --------
    >>> defects = Defects(pixels=[[17, 4], [80, 31]])
    >>> len(defects.pixels), len(defects.lenses)
    (2, 0)
    """

    pixels: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 2), np.int32))
    lenses: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 2), np.int32))

    def __post_init__(self) -> None:
        for name in ("pixels", "lenses"):
            values = np.array(getattr(self, name), dtype=np.int32)
            if values.ndim != 2 or values.shape[1] != 2:
                raise ValueError(f"{name} of defects must be of shape (k, 2), got {values.shape}")
            self._set(**{name: values})

    def to_dict(self) -> dict[str, Any]:
        """Two encoded arrays."""
        return {
            "pixels": encode_array(self.pixels.astype("<i4")),
            "lenses": encode_array(self.lenses.astype("<i4")),
        }

    @classmethod
    def from_dict(cls, data: Any) -> Defects:
        """Inverse of `to_dict`; KeyError, TypeError or ValueError if `data` is malformed."""
        pixels, lenses = (
            decode_array(data[name], "<i4").reshape(-1, 2) for name in ("pixels", "lenses")
        )
        return cls(pixels, lenses)


def largest_values(lattice: Lattice) -> dict[str, float]:
    """Largest size of the values of each field of a gain map of a lattice."""
    side = float(max(lattice.image_size))
    # A cutting disc of a hundred sides cuts along a straight line.
    return {**_LARGEST, "rim": side, "cut": 100 * side}


def count_terms(degree: int) -> int:
    """Number of terms of a polynomial of the field."""
    return (degree + 1) * (degree + 2) // 2


def choose_degree(lenses: int, degrees: Sequence[int]) -> int:
    """The first of some degrees of a polynomial of the field that so many lenses can tell, or 0."""
    enough = [d for d in degrees if lenses >= _LENSES_PER_TERM * count_terms(d)]
    return enough[0] if enough else 0


def first_half(light: Floats, step: float, limit: float) -> Floats:
    """Distance (...) [px], at most `limit`, at which profiles (..., k) first fall below a half.

    The profiles are at distances `0, step, 2 * step, ...` [px].
    """
    dark = light < 0.5
    first = np.maximum(dark.argmax(-1), 1)[..., None]
    before, after = (np.take_along_axis(light, first - k, -1)[..., 0] for k in (1, 0))
    place = first[..., 0] - (0.5 - after) / np.maximum(before - after, 1e-9)
    crossed = np.where(dark.any(-1), place * step, limit)
    return np.clip(np.where(dark[..., 0], 0, crossed), 0, limit)


def nearest_half(lattice: Lattice) -> float:
    """Half the distance [px] to the nearest microimage."""
    return float(np.hypot(*(lattice.steps @ lattice.basis).T).min() / 2)


def field_monomials(field: Floats, terms: int) -> Floats:
    """(n, terms) `1, X, Y, X^2, X*Y, Y^2, ...` at places (n, 2) of `Lattice.field_place`."""
    degree = next(degree for degree in range(terms) if count_terms(degree) >= terms)
    xs, ys = (np.vander(v, degree + 1, increasing=True) for v in field.T)
    return np.column_stack(
        [xs[:, d - b] * ys[:, b] for d in range(degree + 1) for b in range(d + 1)]
    )


def fit_light(lights: NDArray[np.floating], field: Floats) -> Floats:
    """Factors (terms,) of `field_monomials` for the logarithms of the lights (n,) of lenses.

    A robust fit: dust and dead lenses get no weight. The degree is four if there are enough lenses
    at the places (n, 2) of the field, and if they fill so much of it that all factors but the first
    are within those of a gain map.
    """
    some = evenly(len(lights), ENOUGH_LENSES)
    log = np.log(np.maximum(lights[some], 1e-12))
    for lower in range(len(_DEGREES) + 1):
        degree = choose_degree(len(log), _DEGREES[lower:])
        level = _fit_polynomial(log, field_monomials(field[some], count_terms(degree)))
        if np.abs(level[1:]).max(initial=0) <= _LARGEST["level"]:
            break
    return level


def _fit_polynomial(log: Floats, table: Floats) -> Floats:
    """Factors (t,) of the columns of `table` (n, t) for values (n,), by a robust fit."""
    count = len(log)
    ridge = 1e-9 * max(count, 1) * np.eye(table.shape[1])
    weight = np.ones(count)
    level: Floats = np.zeros(table.shape[1])
    for _ in range(5):
        weighted = weight[:, None] * table
        level[:] = np.linalg.solve(weighted.T @ table + ridge, weighted.T @ log)
        miss = np.abs(log - table @ level)
        spread = 1.0
        if count:
            spread = robust_sigma(miss) + 1e-9
        weight = biweight((miss / (TUKEY_CUTOFF * spread)) ** 2)
    return level


def fit_light_slope(lights: NDArray[np.floating], field: Floats, reach: float) -> Floats:
    """(n, 2) relative slope of the light of lenses [1/px], from the polynomial through it.

    The lenses are at places (n, 2) of the field, whose unit is `reach` [px].
    """
    level = fit_light(lights, field)
    steps = _SMALL_STEP * np.eye(2)
    ahead, behind = (
        [field_monomials(field + sign * step, len(level)) @ level for step in steps]
        for sign in (1, -1)
    )
    return np.subtract(ahead, behind).T / (2 * _SMALL_STEP * reach)
