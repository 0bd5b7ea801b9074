"""Sub-pixel patch size: robust least squares on the pixels of a lens and its neighbours."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from .fastmath import FAST
from .radiance import GrayFlat

__all__ = ["refine"]

# Each step may move this far [px]: the starting value is the best of a finer grid.
_MAX_STEP = 1.0
# Steps shrink with their square: after this one [px] the next would not show.
_SETTLED = 0.02


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _accumulate(image, ax, ay, bx, by, radius, s, pitch, scale2, offset):
    """Normal equation of one pair for a change of s, residuals weighted after Geman and McClure."""
    height, width = image.shape
    ex, ey = bx - ax, by - ay
    ux, uy = ex / pitch, ey / pitch
    tx, ty = ex + s * ux, ey + s * uy
    x0, y0 = int(np.floor(tx)), int(np.floor(ty))
    fx, fy = np.float32(tx - x0), np.float32(ty - y0)
    r2 = radius * radius
    qx, qy = bx - tx, by - ty
    hessian = gradient = energy = weights = residuals = np.float32(0.0)
    count = 0
    top = max(int(np.ceil(max(ay, qy) - radius)), max(1, 1 - y0))
    bottom = min(int(np.floor(min(ay, qy) + radius)), min(height - 2, height - 3 - y0))
    for y in range(top, bottom + 1):
        ha = r2 - (y - ay) * (y - ay)
        hb = r2 - (y - qy) * (y - qy)
        if ha <= 0 or hb <= 0:
            continue
        ha, hb = np.sqrt(ha), np.sqrt(hb)
        left = max(int(np.ceil(max(ax - ha, qx - hb))), max(1, 1 - x0))
        right = min(int(np.floor(min(ax + ha, qx + hb))), min(width - 2, width - 3 - x0))
        n = right - left + 1
        if n <= 0:
            continue
        above = image[y - 1, left - 1 : right + 2]
        row = image[y, left - 1 : right + 2]
        below = image[y + 1, left - 1 : right + 2]
        r0 = image[y + y0 - 1, left + x0 - 1 : right + x0 + 3]
        r1 = image[y + y0, left + x0 - 1 : right + x0 + 3]
        r2_ = image[y + y0 + 1, left + x0 - 1 : right + x0 + 3]
        r3 = image[y + y0 + 2, left + x0 - 1 : right + x0 + 3]
        count += n
        for k in range(n):
            # Catmull-Rom would cost four times the loads; linear in both is unbiased once the
            # gradient is the mean of both microimages (Baker and Matthews 2004, symmetric form).
            b = (1 - fy) * ((1 - fx) * r1[k + 1] + fx * r1[k + 2]) + fy * ((1 - fx) * r2_[k + 1] + fx * r2_[k + 2])
            bgx = (1 - fy) * ((1 - fx) * (r1[k + 2] - r1[k]) + fx * (r1[k + 3] - r1[k + 1])) + fy * (
                (1 - fx) * (r2_[k + 2] - r2_[k]) + fx * (r2_[k + 3] - r2_[k + 1])
            )
            bgy = (1 - fy) * ((1 - fx) * (r2_[k + 1] - r0[k + 1]) + fx * (r2_[k + 2] - r0[k + 2])) + fy * (
                (1 - fx) * (r3[k + 1] - r1[k + 1]) + fx * (r3[k + 2] - r1[k + 2])
            )
            agx = row[k + 2] - row[k]
            agy = below[k + 1] - above[k + 1]
            slope = np.float32(0.25) * ((agx + bgx) * ux + (agy + bgy) * uy)
            residual = row[k + 1] - b - offset
            w = scale2 / (scale2 + residual * residual)
            w = w * w
            hessian += w * slope * slope
            gradient += w * slope * residual
            energy += w * residual * residual
            weights += w
            residuals += w * residual
    return hessian, gradient, energy, weights, residuals, count


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _refine(image, centres, radius, pitch, rows, start, scale2, iterations, out):
    for lens in prange(len(centres)):
        s = start[lens]
        out[lens, 0] = s
        out[lens, 1] = np.inf
        if not np.isfinite(s):
            continue
        offsets = np.zeros(rows.shape[1], np.float32)
        hessian = energy = weights = np.float32(0.0)
        for _ in range(iterations):
            hessian = gradient = energy = weights = np.float32(0.0)
            for d in range(rows.shape[1]):
                other = rows[lens, d]
                if other < 0:
                    continue
                h, g, e, w, r, _c = _accumulate(
                    image, centres[lens, 0], centres[lens, 1], centres[other, 0], centres[other, 1],
                    radius, s, pitch, scale2[lens], offsets[d],
                )  # fmt: skip
                if w > 1:
                    offsets[d] += np.float32(0.5) * r / w
                hessian += h
                gradient += g
                energy += e
                weights += w
            if hessian <= 1e-9:
                break
            step = gradient / hessian
            s += min(max(step, -_MAX_STEP), _MAX_STEP)
            if abs(step) < _SETTLED:
                break
        if hessian > 1e-9 and abs(s - start[lens]) < 2.5:
            out[lens, 0] = s
            out[lens, 1] = np.sqrt(energy / max(weights, np.float32(1.0)) / hessian)


def refine(
    gray: GrayFlat,
    rows: NDArray[np.int32],
    start: NDArray[np.float32],
    scale: NDArray[np.float32],
    iterations: int,
) -> NDArray[np.float32]:
    """Patch size of each lens by Gauss-Newton steps from `start`, with its standard error.

    Parameters
    ----------
    gray : GrayFlat
    rows : (n, k) int32
        Neighbours to compare each lens with, -1 where there is none.
    start : (n,) float32 [px of `gray`]
        First values, NaN for lenses to leave alone.
    scale : (n,) float32
        Difference of brightness beyond which two pixels hardly count as the same point.
    iterations : int

    Returns
    -------
    (n, 2) float32 [px of `gray`]
        Patch size and standard error (inf where it could not be refined).
    """
    out = np.empty((len(start), 2), np.float32)
    _refine(
        gray.image, gray.centres, np.float32(gray.radius), np.float32(gray.pitch), rows,
        start.astype(np.float32), (scale * scale).astype(np.float32), iterations, out,
    )  # fmt: skip
    return out
