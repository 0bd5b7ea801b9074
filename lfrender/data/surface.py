"""The depth of every scene point: patch sizes on a regular grid, and how they are interpolated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from lfcal.runtime.fastmath import FAST
from lfcal.runtime.frozen import Frozen
from lfcal.runtime.kernels.jit import kernel

from .settings import DEFAULT, DataSettings

__all__ = [
    "DepthGrid", "Surface", "constant_surface", "edge_step", "mark_changed_places", "patch_size_at", "sample_surface",
    "sample_surface_at",
]  # fmt: skip

# Side of the blocks of grid values that are compared first, so that lenses amid equal blocks are skipped.
_BLOCK = 4


class DepthGrid(NamedTuple):
    """Where the grid values of a surface lie, for kernels, all in float32 [px].

    Without the values: Numba counts references each time that an array is taken out of a tuple, which costs more than
    reading a value.
    """

    x: Any  # scene coordinates of the first grid value
    y: Any
    spacing: Any
    edge: Any  # patch sizes that differ by less belong to one surface


@njit(fastmath=FAST, inline="always")
def patch_size_at(surface, grid, x, y):
    """Patch size at scene point (x, y): linear between the values of the surface, nearest across a depth edge."""
    rows, columns = surface.shape
    gx = min(max((x - grid.x) / grid.spacing, np.float32(0.0)), np.float32(columns - 1))
    gy = min(max((y - grid.y) / grid.spacing, np.float32(0.0)), np.float32(rows - 1))
    i, j = min(int(gx), max(columns - 2, 0)), min(int(gy), max(rows - 2, 0))
    i1, j1 = min(i + 1, columns - 1), min(j + 1, rows - 1)
    fx, fy = gx - i, gy - j
    a, b, c, d = surface[j, i], surface[j, i1], surface[j1, i], surface[j1, i1]
    if max(max(a, b), max(c, d)) - min(min(a, b), min(c, d)) < grid.edge:
        return (1 - fy) * ((1 - fx) * a + fx * b) + fy * ((1 - fx) * c + fx * d)
    return surface[j1 if fy > 0.5 else j, i1 if fx > 0.5 else i]


@kernel(share=lambda values, first_x, first_y, spacing, points, out: len(out))
def _nearest(begin, end, values, first_x, first_y, spacing, points, out):
    rows, columns = values.shape
    for k in range(begin, end):
        u, v = np.rint((points[k, 0] - first_x) / spacing), np.rint((points[k, 1] - first_y) / spacing)
        out[k] = values[min(max(int(v), 0), rows - 1), min(max(int(u), 0), columns - 1)]


@njit
def _differ(old, new, top, bottom, left, right):
    """Whether any value of some rows and columns differs."""
    for v in range(top, bottom):
        for u in range(left, right):
            if old[v, u] != new[v, u]:
                return True
    return False


@kernel(error_model="numpy", fastmath=FAST, share=lambda old, new, some: len(some))
def _mark_blocks(begin, end, old, new, some):
    """Set `some` of the blocks that differ between two surfaces, and unset the rest."""
    rows, columns = new.shape
    for j in range(begin, end):
        for i in range(some.shape[1]):
            v, u = j * _BLOCK, i * _BLOCK
            some[j, i] = _differ(old, new, v, min(v + _BLOCK, rows), u, min(u + _BLOCK, columns))


@kernel(error_model="numpy", fastmath=FAST, share=lambda *given: len(given[6]))
def _mark_changes(begin, end, old, new, some, first_x, first_y, spacing, centres, reach, changed):
    """Set `changed` of lenses with a value within `reach` that differs between two surfaces, in `some` blocks."""
    rows, columns = new.shape
    for lens in range(begin, end):
        if changed[lens]:
            continue
        x, y = (centres[lens, 0] - first_x) / spacing, (centres[lens, 1] - first_y) / spacing
        side = reach / spacing
        top, bottom = max(0, int(np.ceil(y - side))), min(rows, int(np.floor(y + side)) + 1)
        left, right = max(0, int(np.ceil(x - side))), min(columns, int(np.floor(x + side)) + 1)
        for j in range(top // _BLOCK, (bottom + _BLOCK - 1) // _BLOCK):
            for i in range(left // _BLOCK, (right + _BLOCK - 1) // _BLOCK):
                if some[j, i] and not changed[lens]:
                    v, u = j * _BLOCK, i * _BLOCK
                    changed[lens] = _differ(
                        old, new, max(v, top), min(v + _BLOCK, bottom), max(u, left), min(u + _BLOCK, right)
                    )  # fmt: skip


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
    >>> sample = lfrender.data.house(size=(240, 180), samples=2)
    >>> flat, camera = sample.flat, sample.truth.calibration
    >>> depth = lfrender.analyze(flat, camera, "fast")
    >>> rows, columns = depth.surface.patch_size.shape
    >>> depth.surface.at(np.array([[120.0, 90.0]])).shape  # patch size at a place of the scene
    (1,)
    """

    patch_size: NDArray[np.float32]
    first: tuple[float, float]
    spacing: float

    def __repr__(self) -> str:
        rows, columns = self.patch_size.shape
        return f"Surface({columns} x {rows} patch sizes, {self.spacing:.3g} px apart)"

    def grid(self, edge: float) -> DepthGrid:
        """For kernels; patch sizes that differ by less than `edge` [px] belong to one surface."""
        x, y, spacing, step = np.array([*self.first, self.spacing, edge], np.float32)
        return DepthGrid(x, y, spacing, step)

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        """(n,) float32 [px]: patch size of the grid value nearest to scene points (n, 2)."""
        out = np.empty(len(points), np.float32)
        _nearest(self.patch_size, *self.first, self.spacing, points, out)
        return out


def edge_step(pitch: float, settings: DataSettings = DEFAULT) -> float:
    """Patch sizes that differ by less than this belong to one surface [px]."""
    return max(settings.edge_pixels, settings.edge_share * pitch)


def sample_surface(surface: Surface, pitch: float, shape: tuple[int, int], spacing: float) -> NDArray[np.float32]:
    """Patch size [px] at every pixel of a picture of this shape, whose pixels are `spacing` apart on the flat."""
    first = 0.5 * spacing - 0.5
    return sample_surface_at(surface, edge_step(pitch), shape, (first, first), spacing)


def sample_surface_at(
    surface: Surface, edge: float, shape: tuple[int, int], first: ArrayLike, spacing: float
) -> NDArray[np.float32]:
    """As `sample_surface`, of a picture whose pixel (0, 0) lies at `first` (2,), with an edge step of `edge` [px]."""
    out = np.empty(shape, np.float32)
    first_x, first_y = (float(n) for n in np.asarray(first))
    _sample(surface.patch_size, surface.grid(edge), first_x, first_y, spacing, out)
    return out


def mark_changed_places(
    before: Surface, after: Surface, places: NDArray[np.floating], reach: float, changed: NDArray[np.bool_]
) -> None:
    """Set `changed` (n,) where a grid value differs within `reach` [px] of `places` (n, 2); the grids are the same."""
    old, new = before.patch_size, after.patch_size
    some = np.empty((-(-new.shape[0] // _BLOCK), -(-new.shape[1] // _BLOCK)), bool)
    _mark_blocks(old, new, some)
    _mark_changes(old, new, some, *after.first, after.spacing, places, reach, changed)


def constant_surface(patch_size: float) -> Surface:
    """The surface of one patch size [px] for all scene points."""
    return Surface(np.full((1, 1), patch_size, np.float32), (0.0, 0.0), 1.0)
