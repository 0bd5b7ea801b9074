"""Correlation of neighbouring microimages over signed shifts."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from .fastmath import FAST
from .radiance import GrayFlat

__all__ = ["pair_costs"]

# Part of a difference in mean brightness that counts as mismatch: neighbouring lenses may differ a
# little in gain, but on a smooth slope their means are all that tells the depth.
_OFFSET_WEIGHT = np.float32(0.5)
# Share of a microimage that must be common for a match to count half: some dozens of independent details. A larger
# one would pull patch sizes toward zero, where more is shared.
_HALF_TRUST = 0.06
# Shading that correction leaves behind looks like weak texture without disparity: a match this near
# zero (in pitches) is doubted by half where the contrast (white = 1) is only this.
_SHADED_REACH = np.float32(0.08)
_SHADED = np.float32(0.03)


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _moments(image, ax, ay, bx, by, radius, tx, ty, mean, row_step):
    """Sums over all pixels of lens a whose partner, `(tx, ty)` away, lies in lens b."""
    height, width = image.shape
    x0, y0 = int(np.floor(tx)), int(np.floor(ty))
    fx, fy = np.float32(tx - x0), np.float32(ty - y0)
    w00, w01 = (1 - fx) * (1 - fy), fx * (1 - fy)
    w10, w11 = (1 - fx) * fy, fx * fy
    sa = sb = saa = sbb = sab = np.float32(0.0)
    count = 0
    r2 = radius * radius
    # Centre of lens b's disc as seen from lens a's pixels.
    qx, qy = bx - tx, by - ty
    top = max(int(np.ceil(max(ay, qy) - radius)), max(0, -y0))
    bottom = min(int(np.floor(min(ay, qy) + radius)), min(height - 1, height - 2 - y0))
    for y in range(top, bottom + 1, row_step):
        ha = r2 - (y - ay) * (y - ay)
        hb = r2 - (y - qy) * (y - qy)
        if ha <= 0 or hb <= 0:
            continue
        ha, hb = np.sqrt(ha), np.sqrt(hb)
        left = max(int(np.ceil(max(ax - ha, qx - hb))), max(0, -x0))
        right = min(int(np.floor(min(ax + ha, qx + hb))), min(width - 1, width - 2 - x0))
        n = right - left + 1
        if n <= 0:
            continue
        row = image[y, left : right + 1]
        upper = image[y + y0, left + x0 : right + x0 + 2]
        lower = image[y + y0 + 1, left + x0 : right + x0 + 2]
        count += n
        for k in range(n):
            a = row[k] - mean
            b = w00 * upper[k] + w01 * upper[k + 1] + w10 * lower[k] + w11 * lower[k + 1] - mean
            sa += a
            sb += b
            saa += a * a
            sbb += b * b
            sab += a * b
    return count, sa, sb, saa, sbb, sab


@njit(cache=True, nogil=True, parallel=True, fastmath=FAST)
def _pair_costs(
    image,
    centres,
    radius,
    pitch,
    rows,
    means,
    contrast,
    active,
    done,
    shifts,
    which,
    noise,
    shading,
    row_step,
    half,
    about,
    out,
):
    for lens in prange(len(centres)):
        ax, ay = centres[lens, 0], centres[lens, 1]
        for d in range(rows.shape[1]):
            other = rows[lens, d]
            if other < 0 or not (active[lens] or active[other]) or done[lens] or done[other]:
                continue
            bx, by = centres[other, 0], centres[other, 1]
            mean = np.float32(0.5) * (means[lens] + means[other])
            floor = np.float32(2.0) * (noise * noise + shading * shading * mean * mean)
            texture = min(contrast[lens], contrast[other])
            doubt = _SHADED**2 / (_SHADED**2 + texture * texture)
            middle = np.float32(0.0)
            if len(about) > 0:
                middle = np.float32(0.5) * (about[lens] + about[other])
            for k in which:
                shift = middle + shifts[k]
                grow = 1.0 + shift / pitch
                count, sa, sb, saa, sbb, sab = _moments(
                    image, ax, ay, bx, by, radius, (bx - ax) * grow, (by - ay) * grow, mean, row_step
                )
                if count < 4:
                    continue
                inverse = np.float32(1.0) / count
                ma, mb = sa * inverse, sb * inverse
                variance = (saa + sbb) * inverse - ma * ma - mb * mb
                offset = _OFFSET_WEIGHT * (ma - mb) * (ma - mb)
                residual = variance - 2 * (sab * inverse - ma * mb) + offset
                quality = (residual + floor) / (variance + offset + floor)
                trust = count * row_step / (count * row_step + half)
                trust *= 1 - doubt * np.exp(-((shift / (_SHADED_REACH * pitch)) ** 2))
                out[lens, d, k] = 1.0 - trust * (1.0 - quality)


def pair_costs(
    gray: GrayFlat,
    rows: NDArray[np.int32],
    means: NDArray[np.float32],
    contrast: NDArray[np.float32],
    active: NDArray[np.bool_],
    shifts: NDArray[np.float32],
    noise: float,
    shading: float,
    row_step: int = 1,
    which: NDArray[np.int64] | None = None,
    done: NDArray[np.bool_] | None = None,
    out: NDArray[np.float32] | None = None,
    about: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """How badly each lens agrees with its neighbours if the scene had each of some patch sizes.

    The cost is `1 - rho`, the correlation coefficient over the pixels that both microimages show
    at that shift, half-way invariant to a difference of their means, shrunk toward 1 where noise
    or shading explain the contrast or where they share few pixels.

    Parameters
    ----------
    gray : GrayFlat
    rows : (n, d) int32
        One neighbour of each lens in `d` directions, -1 where there is none.
    means, contrast : (n,) float32
        Mean and standard deviation of each lens.
    active : (n,) bool
        Pairs without an active lens are not matched and cost 1.
    shifts : (k,) float32 [px of `gray`]
        Signed patch sizes to try.
    noise : float
        Standard deviation of a pixel.
    shading : float
        Fixed contrast inside every microimage, as a share of its mean.
    row_step : int
        Only every `row_step`-th row of pixels is read.
    which : (m,) int, optional
        The shifts to match; all by default.
    done : (n,) bool, optional
        Lenses all of whose pairs are in `out` already.
    out : (n, d, k) float32, optional
        Costs to be added to; by default all are 1 before.
    about : (n,) float32, optional [px of `gray`]
        Patch size of each lens that `shifts` are relative to; by default 0.

    Returns
    -------
    (n, d, k) float32
    """
    out = np.ones((len(gray.centres), rows.shape[1], len(shifts)), np.float32) if out is None else out
    which = np.arange(len(shifts)) if which is None else which
    done = np.zeros(len(active), bool) if done is None else done
    about = np.empty(0, np.float32) if about is None else about.astype(np.float32)
    half = np.float32(_HALF_TRUST * np.pi * gray.radius**2)
    _pair_costs(
        gray.image, gray.centres, np.float32(gray.radius), np.float32(gray.pitch), rows, means, contrast, active,
        done, shifts.astype(np.float32), which, np.float32(noise), np.float32(shading), row_step, half, about, out,
    )  # fmt: skip
    return out
