"""Flats of a textured plane, drawn from a random spline: exact at every pixel, and cheap enough for
thousands.

Shares no code with `lfcal` or `lfrender`: the formulas are written down here from docs/geometry.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

import lfcal

__all__ = ["CELLS", "PlaneFlat", "quantised", "turned"]

CELLS = {
    "hexagonal": ((1.0, 0.0), (0.5, np.sqrt(0.75))),
    "square": ((1.0, 0.0), (0.0, 1.0)),
    "oblong": ((1.0, 0.0), (0.0, 1.2)),
    "sheared": ((1.0, 0.0), (0.25, 1.0)),
}
_ROWS = 64
# Standard deviation of a cubic B-spline in two dimensions with random coefficients of standard
# deviation 1, about.
_SPLINE = 0.48
# Light beside the discs over the light in them.
_GAP = 0.03


def turned(cell: NDArray[np.float64], pitch: float, degrees: float) -> NDArray[np.float64]:
    """(2, 2) basis rows [px] of a lattice `cell` of mean neighbour distance `pitch`, turned
    clockwise on the screen.
    """
    cos = np.cos(np.radians(degrees))
    sin = np.sin(np.radians(degrees))
    basis = np.asarray(cell) @ np.array([[cos, sin], [-sin, cos]])
    return basis * (pitch / lfcal.Lattice(np.zeros(2), basis, (1, 1), 1.0).pitch)


def quantised(light: NDArray[np.float64], kind: Literal["u1", "u2", "f4"]) -> NDArray[Any]:
    """Light, 1 at white, as 8 bit, 16 bit or float32 pixels; clipped at white and at black."""
    light = np.clip(light, 0, 1)
    if kind == "f4":
        return light.astype(np.float32)
    full = np.iinfo(kind).max
    return np.rint(light * full).astype(kind)


@dataclass(frozen=True)
class PlaneFlat:
    """A flat of one textured plane.

    Parameters
    ----------
    ratio : float
        `s / D` at the middle of the flat.
    slant : (float, float)
        Change of `D / s` over the width and the height of the flat.
    cell : str
        One of `CELLS`.
    pitch : float [px]
    degrees : float
        Rotation of the lattice, clockwise on the screen.
    size : (int, int) [px]
        Width and height.
    contrast : float
        Standard deviation of the texture over its mean.
    noise : float
        Standard deviation of white noise, 1 at white.
    grain : float [px]
        Distance between the random knots of the texture on the flat.
    period : float
        A texture that repeats after so many pitches in the microimage, both ways; 0 for one that
        does not repeat.
    exposure : float
        Mean light in the discs, 1 at white.
    fill : float
        Diameter of the discs over the distance to the nearest neighbour; 0 for no discs: light
        everywhere.
    kind : {"u1", "u2", "f4"}
        8 bit, 16 bit, float32.
    shift : (float, float) [px]
        Added to the origin of the lattice.
    seed : int
        Of texture and noise.
    own_cell : 2 x 2 floats or None
        Instead of `cell`.
    """

    ratio: float = -0.3
    slant: tuple[float, float] = (0.0, 0.0)
    cell: str = "hexagonal"
    pitch: float = 23.2
    degrees: float = 1.3
    size: tuple[int, int] = (300, 260)
    contrast: float = 0.25
    noise: float = 0.0
    grain: float = 2.0
    period: float = 0.0
    exposure: float = 0.45
    fill: float = 0.0
    kind: Literal["u1", "u2", "f4"] = "u2"
    shift: tuple[float, float] = (0.0, 0.0)
    seed: int = 0
    own_cell: tuple[tuple[float, ...], ...] | None = None

    @cached_property
    def lattice(self) -> lfcal.Lattice:
        """The true lattice."""
        basis = turned(np.array(self.own_cell or CELLS[self.cell]), self.pitch, self.degrees)
        origin = (
            (np.array(self.size) - 1) / 2
            + np.array([0.31, -0.17]) * self.pitch
            + np.array(self.shift)
        )
        nearest = np.hypot(*(np.array([(1, 0), (0, 1), (1, 1), (1, -1)]) @ basis).T).min()
        radius = nearest / 2 * (self.fill or 0.97)
        return lfcal.Lattice(origin, basis, self.size, radius)

    @property
    def calibration(self) -> lfcal.Calibration:
        """The true camera."""
        return lfcal.Calibration(self.lattice, source="truth")

    def patch_size(self, centres: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) true signed patch size [px] of lenses at `centres` (n, 2) [px]; 1 / s is linear on a
        plane.
        """
        size = np.array(self.size)
        away = (centres - (size - 1) / 2 - np.array(self.shift)) / size
        return self.pitch / (1 / self.ratio + away @ np.array(self.slant))

    def light(self) -> NDArray[np.float64]:
        """(h, w) light with noise, 1 at white."""
        rng = np.random.default_rng(self.seed)
        texture = self._texture(rng)
        width, height = self.size
        out = np.empty((height, width))
        for top in range(0, height, _ROWS):
            y, x = np.mgrid[top : min(top + _ROWS, height), :width].astype(float)
            out[top : top + _ROWS] = self._rows(
                np.column_stack([x.ravel(), y.ravel()]), texture
            ).reshape(x.shape)
        return out + self.noise * rng.standard_normal(out.shape)

    def scene(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) light of the plane itself at scene coordinates (n, 2) [px], 1 at white."""
        texture = self._texture(np.random.default_rng(self.seed))
        return self.exposure * (1 + self.contrast * texture(places * self.ratio))

    def flat(self) -> NDArray[Any]:
        """(h, w) the flat."""
        return quantised(self.light(), self.kind)

    def _texture(
        self, rng: np.random.Generator
    ) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
        """Value, of mean 0 and standard deviation 1, at places (n, 2) of the scene in pixels as it
        has on the flat.
        """
        if self.period:
            step = 2 * np.pi / (self.period * self.pitch)
            phase = rng.uniform(0, 2 * np.pi, 2)
            return lambda places: np.sin(places * step + phase).sum(1)
        # What the flat sees of the scene, and a disc's width of it on either side.
        steepest = abs(1 / self.ratio) + np.abs(self.slant).sum()
        low = -2 * self.pitch * abs(self.ratio) * steepest - 4 * self.grain
        high = abs(self.ratio) * np.array(self.size) - low
        knots = rng.standard_normal(np.ceil((high - low) / self.grain).astype(int))
        start = np.minimum(0, np.array(self.size) * self.ratio)

        def at(places: NDArray[np.float64]) -> NDArray[np.float64]:
            where = ((places - start - low) / self.grain).T
            return (
                np.asarray(map_coordinates(knots, where, order=3, mode="mirror", prefilter=False))
                / _SPLINE
            )

        return at

    def _rows(
        self,
        points: NDArray[np.float64],
        texture: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    ) -> NDArray[np.float64]:
        """(n,) light without noise at flat positions (n, 2)."""
        basis = self.lattice.basis
        origin = self.lattice.origin
        start = np.rint((points - origin) @ np.linalg.inv(basis))
        own = np.zeros_like(points)
        near = np.full(len(points), np.inf)
        for step in np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), -1).reshape(-1, 2):
            centre = origin + (start + step) @ basis
            distance = ((points - centre) ** 2).sum(1)
            own[distance < near] = centre[distance < near]
            near = np.minimum(near, distance)
        delta = points - own
        inverse = self.pitch / self.patch_size(own)
        tilt = np.array(self.slant) / np.array(self.size)
        # Within a lens D / s changes with X, and X with it: two steps of the fixed point are exact
        # to 1e-4.
        for _ in range(2):
            scene = own - delta * inverse[:, None]
            inverse = self.pitch / self.patch_size(own) + (scene - own) @ tilt
        # The scene is D / |s| times as large as it is on the flat.
        scene = (own - delta * inverse[:, None]) * self.ratio
        light = self.exposure * (1 + self.contrast * texture(scene))
        if self.fill:
            disc = np.clip(self.lattice.radius - np.sqrt(near) + 0.5, 0, 1)
            light = light * (_GAP + (1 - _GAP) * disc)
        return np.asarray(light)
