"""Patch size on a regular grid of scene points: linear on a surface, nearest across an edge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.arrays import Frozen, Singles
from lfcal.runtime.kernels import FAST, kernel

from ..runtime.types import Place, Size

__all__ = [
    "DepthGrid",
    "Surface",
    "constant_surface",
    "edge_step",
    "patch_size_at",
    "sample_surface_at",
]


class DepthGrid(NamedTuple):
    """Where the grid values of a surface lie, for kernels, all in float32 [px]."""

    x: Any  # scene coordinates of the first grid value
    y: Any
    spacing: Any
    edge: Any  # patch sizes that differ by less belong to one surface


@njit(fastmath=FAST, inline="always")
def patch_size_at(surface, grid, x, y):
    """Patch size at scene point (x, y): linear on one surface, nearest across a depth edge."""
    rows, columns = surface.shape
    gx = min(max((x - grid.x) / grid.spacing, np.float32(0.0)), np.float32(columns - 1))
    gy = min(max((y - grid.y) / grid.spacing, np.float32(0.0)), np.float32(rows - 1))
    i = min(int(gx), max(columns - 2, 0))
    j = min(int(gy), max(rows - 2, 0))
    i1 = min(i + 1, columns - 1)
    j1 = min(j + 1, rows - 1)
    fx = gx - i
    fy = gy - j
    a = surface[j, i]
    b = surface[j, i1]
    c = surface[j1, i]
    d = surface[j1, i1]
    if max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) < grid.edge:
        return (1 - fy) * ((1 - fx) * a + fx * b) + fy * ((1 - fx) * c + fx * d)
    return surface[j1 if fy > 0.5 else j, i1 if fx > 0.5 else i]


@kernel(error_model="numpy", share=lambda *given: len(given[5]))
def _sample(begin, end, surface, grid, first_x, first_y, spacing, out):
    for v in range(begin, end):
        y = np.float32(first_y + v * spacing)
        for u in range(out.shape[1]):
            out[v, u] = patch_size_at(surface, grid, np.float32(first_x + u * spacing), y)


@dataclass(frozen=True, eq=False, repr=False)
class Surface(Frozen):
    """Signed patch size on a regular grid of scene points.

    Parameters
    ----------
    patch_size : (h, w) float32 [px]
        Finite everywhere.
    first : (float, float) [px]
        Scene coordinates of grid value `[0, 0]`, order `x, y`.
    spacing : float [px]
        Distance between grid values in scene coordinates.

    Examples
    --------
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> depth.surface.at(np.array([[120.0, 90.0]])).shape  # patch size at a place of the scene
    (1,)
    """

    patch_size: Singles
    first: Place
    spacing: float

    def __post_init__(self) -> None:
        place = np.array([*self.first, self.spacing], np.float64)
        is_grid = np.ndim(self.patch_size) == 2 and np.size(self.patch_size) > 0
        if not is_grid or not np.isfinite(place).all() or self.spacing <= 0:
            raise ValueError(
                "a surface has rows and columns, a finite place and a positive spacing, got "
                f"{np.shape(self.patch_size)}, {self.first} and {self.spacing}"
            )

    def __repr__(self) -> str:
        rows, columns = self.patch_size.shape
        return f"Surface({columns} x {rows} patch sizes, {self.spacing:.3g} px apart)"

    def grid(self, edge: float) -> DepthGrid:
        """For kernels; patch sizes that differ by less than `edge` [px] belong to one surface."""
        return DepthGrid(*np.array([*self.first, self.spacing, edge], np.float32))

    @property
    def last(self) -> NDArray[np.floating]:
        """(2,) [px]: scene coordinates of the last grid value, order `x, y`."""
        steps = np.array(self.patch_size.shape[::-1]) - 1
        return np.array(self.first) + self.spacing * steps

    def thinned(self, most: int) -> Surface:
        """Every k-th value, so that at most `most` are left in a row or column, for plots."""
        step = -(-max(self.patch_size.shape) // most)
        return Surface(self.patch_size[::step, ::step], self.first, step * self.spacing)

    def at(self, points: NDArray[np.floating]) -> Singles:
        """(n,) float32 [px]: patch size of the grid value nearest to scene points (n, 2)."""
        rows, columns = self.patch_size.shape
        u, v = np.rint((points - self.first) / self.spacing).astype(int).T
        return self.patch_size[v.clip(0, rows - 1), u.clip(0, columns - 1)]


def edge_step(pitch: float) -> float:
    """Patch sizes that differ by less than this belong to one surface [px]."""
    return max(0.5, 0.03 * pitch)


def sample_surface_at(
    surface: Surface, edge: float, shape: Size, first: Any, spacing: float
) -> Singles:
    """Patch size [px] at every pixel of a picture.

    Pixels lie `spacing` apart, the first at `first` (2,); `edge` [px] is that of `edge_step`.
    """
    out = np.empty(shape, np.float32)
    _sample(surface.patch_size, surface.grid(edge), float(first[0]), float(first[1]), spacing, out)
    return out


def constant_surface(patch_size: float) -> Surface:
    """The surface of one patch size [px] for all scene points."""
    return Surface(np.full((1, 1), patch_size, np.float32), (0.0, 0.0), 1.0)
