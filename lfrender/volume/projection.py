"""The forward model of a light-field microscope, and its exact adjoint.

A pixel at `delta` from the centre `c` of its microlens sees of the plane at depth z the place

    X = c + k g(delta),    k = -D / s,    g = delta / sqrt(1 - |delta|^2 / rho^2),

with the vocabulary of docs/geometry.md; `rho` is the radius of a microimage at which rays would lie
flat (sine condition of Abbe; infinite where the optics are paraxial). `k` is in proportion to z and
0 at the native plane, which is focused onto the microlenses. What a pixel averages over there is in
`footprint`.

The flat is the sum over planes of what its pixels see there. No matrix is stored: both directions
walk over pixels and planes, in a time proportional to their product.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from lfcal.runtime.arrays import Floats, Singles
from lfcal.runtime.kernels import FAST, kernel

from ..runtime.types import Size
from .footprint import blur, blur_planes

__all__ = ["Projector", "Rays"]

# Planes that are copied and blurred at a time: bounds the memory.
_TOGETHER = 8


class Rays(NamedTuple):
    """Where pixels look, in voxels: `x = centre_x + k angle_x`."""

    centre_x: Singles  # (p,)
    centre_y: Singles
    angle_x: Singles
    angle_y: Singles


@njit(fastmath=FAST, inline="always")
def _locate(rays, p, k, plane):
    """Place of pixel `p` on a plane (h, w) at slope `k`.

    Returns whether it lies inside, row and column of the voxel above and to the left, and the
    distances down and to the right from it.
    """
    x = rays.centre_x[p] + k * rays.angle_x[p]
    y = rays.centre_y[p] + k * rays.angle_y[p]
    column = int(np.floor(x))
    row = int(np.floor(y))
    inside = 0 <= row < plane.shape[0] - 1 and 0 <= column < plane.shape[1] - 1
    return inside, row, column, y - row, x - column


@kernel(share=lambda planes, slopes, rays, out: len(out), fastmath=FAST)
def _gather(begin, end, planes, slopes, rays, out):
    """Add to `out` (p,) what pixels see of planes (n, h, w) at slopes (n,), bilinearly."""
    for plane in range(len(planes)):
        values = planes[plane]
        for p in range(begin, end):
            inside, row, column, low, right = _locate(rays, p, slopes[plane], values)
            if not inside:
                continue
            upper = values[row]
            lower = values[row + 1]
            above = upper[column] + right * (upper[column + 1] - upper[column])
            below = lower[column] + right * (lower[column + 1] - lower[column])
            out[p] += above + low * (below - above)


@njit(fastmath=FAST, forceinline=True)
def _scatter(values, k, rays, plane):
    """The adjoint of `_gather` for one plane (h, w), which is overwritten."""
    plane[:] = 0.0
    for p in range(len(values)):
        inside, row, column, low, right = _locate(rays, p, k, plane)
        if not inside:
            continue
        below = low * values[p]
        above = values[p] - below
        plane[row, column] += above - right * above
        plane[row, column + 1] += right * above
        plane[row + 1, column] += below - right * below
        plane[row + 1, column + 1] += right * below


@kernel(share=lambda values, slopes, widths, rays, out: len(out))
def _backproject(begin, end, values, slopes, widths, rays, out):
    for plane in range(begin, end):
        _scatter(values, slopes[plane], rays, out[plane])
        blur(out[plane], widths[plane])


@kernel(share=lambda values, slopes, widths, rays, norm, volume: len(volume))
def _multiply(begin, end, values, slopes, widths, rays, norm, volume):
    """Multiply planes of a volume by the adjoint of `values` over `norm`; 0 where it is 0."""
    update = np.empty(volume.shape[1:], np.float32)
    for plane in range(begin, end):
        _scatter(values, slopes[plane], rays, update)
        blur(update, widths[plane])
        for y in range(update.shape[0]):
            for x in range(update.shape[1]):
                light = norm[plane, y, x]
                if light > 0.0:
                    volume[plane, y, x] *= max(update[y, x], np.float32(0.0)) / light
                else:
                    volume[plane, y, x] = 0.0


@dataclass(frozen=True)
class Projector:
    """The linear operator from a volume (n, h, w) to pixels (p,) of a flat, and its adjoint."""

    rays: Rays
    slopes: Singles  # (n,) k of each plane
    widths: Floats  # (n, b) boxes of the footprint on each plane [voxels]
    shape: Size  # of a plane

    def forward(self, volume: Singles) -> Singles:
        """(p,) what the pixels see of a volume."""
        out = np.zeros(len(self.rays.centre_x), np.float32)
        for first in range(0, len(volume), _TOGETHER):
            some = slice(first, first + _TOGETHER)
            planes = volume[some].copy()
            blur_planes(planes, self.widths[some])
            _gather(planes, self.slopes[some], self.rays, out)
        return out

    def adjoint(self, values: Singles) -> Singles:
        """(n, h, w) volume that values (p,) of the pixels are spread over."""
        out = np.empty((len(self.slopes), *self.shape), np.float32)
        _backproject(values, self.slopes, self.widths, self.rays, out)
        return out

    def multiply(
        self,
        volume: Singles,
        values: Singles,
        norm: Singles,
    ) -> None:
        """Multiply a volume in place by `adjoint(values) / norm`.

        This is done plane by plane, in little memory.
        """
        _multiply(values, self.slopes, self.widths, self.rays, norm, volume)
