"""Surfaces as a table for kernels, and where rays meet them.

A ray in object space is `P(z) = -(A + S * z)`: it leaves the main lens at `A` [mm] with slope `S`,
and the minus is the half turn of object space that keeps pictures upright.

Rows of the table: 0 kind, 1..3 corner or centre, 4..6 normal (4: radius of a sphere), 7..9 and
10..12 duals of the edges, 13 texture offset, 14, 15 its width and height, 16 whether alpha cuts,
17..22 bounds.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .surfaces import Patch, Scene

__all__ = ["add_light", "choose", "hit", "pack"]

_PATCH = 0.0
_SPHERE = 1.0
_COLUMNS = 23


def pack(scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Surface table, nearest first, and one array of all texels (n, 4) float32; shared textures are
    stored once.
    """
    table = np.zeros((len(scene.surfaces), _COLUMNS))
    texels: list[NDArray[np.float32]] = [np.zeros((1, 4), np.float32)]
    placed: dict[int, int] = {}
    used = 1
    for row, surface in zip(
        table, sorted(scene.surfaces, key=lambda s: s.bounds[0, 2]), strict=True
    ):
        texture = surface.texture
        height, width, channels = texture.shape
        if id(texture) not in placed:
            placed[id(texture)] = used
            block = np.ones((height * width, 4), np.float32)
            block[:, :channels] = texture.reshape(-1, channels)
            texels.append(block)
            used += len(block)
        row[13:17] = placed[id(texture)], width, height, channels == 4
        row[17:23] = surface.bounds.ravel()
        if isinstance(surface, Patch):
            normal = np.cross(surface.across, surface.down)
            area = normal @ normal
            row[0], row[1:4], row[4:7] = _PATCH, surface.corner, normal
            row[7:10] = np.cross(surface.down, normal) / area
            row[10:13] = np.cross(normal, surface.across) / area
        else:
            row[0], row[1:4], row[4] = _SPHERE, surface.centre, surface.radius
    return table, np.concatenate(texels)


@njit(error_model="numpy")
def _corner(row, u, v):
    """Where to interpolate a texture: first texel, steps to the next ones, and shares of those.

    Texel centres lie at (k + 0.5) / size; beyond the outermost ones their value is repeated.
    """
    width = int(row[14])
    height = int(row[15])
    x = min(max(u * width - 0.5, 0.0), width - 1.0)
    y = min(max(v * height - 0.5, 0.0), height - 1.0)
    i = min(int(x), max(width - 2, 0))
    j = min(int(y), max(height - 2, 0))
    right = min(1, width - 1)
    below = min(1, height - 1) * width
    return int(row[13]) + j * width + i, right, below, x - i, y - j


@njit(error_model="numpy")
def _opaque(texels, row, u, v):
    """Whether the cut-out texture has something at `(u, v)`."""
    p, right, below, fx, fy = _corner(row, u, v)
    upper = texels[p, 3] * (1 - fx) + texels[p + right, 3] * fx
    lower = texels[p + below, 3] * (1 - fx) + texels[p + below + right, 3] * fx
    return upper * (1 - fy) + lower * fy >= 0.5


@njit(error_model="numpy")
def _meet_patch(row, ox, oy, dx, dy):
    """Depth and texture coordinates where the ray meets the patch; depth inf where it does not."""
    along = row[4] * dx + row[5] * dy + row[6]
    z = (row[4] * (row[1] - ox) + row[5] * (row[2] - oy) + row[6] * row[3]) / along
    if not 0.0 < z < np.inf:
        return np.inf, 0.0, 0.0
    px = ox + dx * z - row[1]
    py = oy + dy * z - row[2]
    pz = z - row[3]
    u = row[7] * px + row[8] * py + row[9] * pz
    v = row[10] * px + row[11] * py + row[12] * pz
    if u < 0.0 or u > 1.0 or v < 0.0 or v > 1.0:
        return np.inf, 0.0, 0.0
    return z, u, v


@njit(error_model="numpy")
def _meet_sphere(row, ox, oy, dx, dy):
    """Depth and texture coordinates where the ray first meets the sphere; depth inf where it does
    not.
    """
    cx = ox - row[1]
    cy = oy - row[2]
    radius = row[4]
    a = dx * dx + dy * dy + 1.0
    half = cx * dx + cy * dy - row[3]
    root = half * half - a * (cx * cx + cy * cy + row[3] * row[3] - radius * radius)
    if root < 0.0:
        return np.inf, 0.0, 0.0
    z = (-half - math.sqrt(root)) / a
    if z <= 0.0:
        return np.inf, 0.0, 0.0
    nx = (cx + dx * z) / radius
    ny = (cy + dy * z) / radius
    nz = (z - row[3]) / radius
    return (
        z,
        math.atan2(nx, -nz) / (2 * math.pi) + 0.5,
        math.asin(min(max(ny, -1.0), 1.0)) / math.pi + 0.5,
    )


@njit(error_model="numpy")
def hit(table, texels, chosen, count, ax, ay, sx, sy):
    """Nearest of the `chosen` surfaces (nearest bounds first): table row or -1, depth, texture
    coordinates.
    """
    best = -1
    depth = np.inf
    best_u = 0.0
    best_v = 0.0
    for k in range(count):
        row = table[chosen[k]]
        if row[19] > depth:
            break
        if row[0] == _PATCH:
            z, u, v = _meet_patch(row, -ax, -ay, -sx, -sy)
        else:
            z, u, v = _meet_sphere(row, -ax, -ay, -sx, -sy)
        if z < depth and (row[16] == 0.0 or _opaque(texels, row, u, v)):
            best = chosen[k]
            depth = z
            best_u = u
            best_v = v
    return best, depth, best_u, best_v


@njit(error_model="numpy")
def choose(chosen, table, ax, ay, sx, sy, start_spread, slope_spread):
    """List the surfaces that a bundle around the ray can meet: starts and slopes differ by the
    spreads at most.
    """
    count = 0
    for k in range(len(table)):
        row = table[k]
        near = row[19]
        far = row[22]
        x0 = -(ax + sx * near)
        x1 = -(ax + sx * far)
        y0 = -(ay + sy * near)
        y1 = -(ay + sy * far)
        room = start_spread + slope_spread * far
        across = max(x0, x1) + room >= row[17] and min(x0, x1) - room <= row[20]
        if across and max(y0, y1) + room >= row[18] and min(y0, y1) - room <= row[21]:
            chosen[count] = k
            count += 1
    return count


@njit(error_model="numpy")
def add_light(total, table, texels, background, found, u, v, weight):
    """Add the radiance at a hit to `total`, its weight to the fourth channel."""
    total[3] += weight
    if found < 0:
        for c in range(3):
            total[c] += weight * background[c]
        return
    p, right, below, fx, fy = _corner(table[found], u, v)
    a = weight * (1 - fx) * (1 - fy)
    b = weight * fx * (1 - fy)
    c = weight * (1 - fx) * fy
    d = weight * fx * fy
    for k in range(3):
        total[k] += a * texels[p, k] + b * texels[p + right, k]
        total[k] += c * texels[p + below, k] + d * texels[p + below + right, k]
