"""Ray tracing: from sensor points through a microlens and the main lens to the nearest surface.

Rays and the table of surfaces are those of `intersection`. Camera vector of the kernels, in mm and
px:

    0 pixel  1, 2 principal point  3 focal length  4 dL  5 b  6 main aperture radius  7 microlens
    radius 8, 9 origin  10..13 basis  14..17 inverse basis  18 spread  19 cos^4  20, 21 stop
    distance and radius (0: none) 22 reach: largest distance of a lit point from its microimage
    centre [px]  23 whether bent: distortion or tilt 24 k1  25, 26 slope of the optical axis in the
    frame of the array  27..35 axes of the array, row by row 36 whether the main aperture is square
    37, 38 direction of its sides 39, 40 growth of b over the sensor, to the right and down
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels import kernel

from .camera import Camera
from .intersection import add_light, choose, hit

__all__ = ["nearest", "pinhole", "sensor"]

# Half the diagonal of a pixel [px], rounded up.
_HALF_DIAGONAL = 0.71


def _camera_vector(camera: Camera) -> NDArray[np.float64]:
    basis = np.array(camera.basis)
    aperture = camera.aperture / 2
    lens = camera.fill * camera.microlens_pitch / 2
    # Edge rays of the microlens land beside the geometric microimage by its defocus on the main
    # lens.
    defocus = max(
        abs(camera.spread - camera.sensor_distance / f) * lens / camera.pixel
        for f in camera.microlens_focal_lengths
    )
    stop = camera.stop or (0.0, 0.0)
    values = [
        camera.pixel,
        *camera.principal_point,
        camera.focal_length,
        camera.mla_distance,
        camera.sensor_distance,
    ]
    side = basis[0] / np.linalg.norm(basis[0])
    reach = camera.microimage_radius * (2**0.5 if camera.square_aperture else 1.0) + defocus
    growth = np.tan(camera.sensor_tilt)
    # Where the sensor is farther away, microimages are larger, and farther from the axis.
    away = float(np.hypot(camera.width, camera.height)) * camera.pixel * float(np.hypot(*growth))
    reach *= 1 + away / camera.sensor_distance
    reach += away / camera.mla_distance * float(np.hypot(camera.width, camera.height))
    values += [
        aperture,
        lens,
        *camera.origin,
        *basis.ravel(),
        *np.linalg.inv(basis).ravel(),
        camera.spread,
    ]
    values += [float(camera.natural_vignetting), stop[0], stop[1] / 2, reach]
    axes = camera.array_axes
    values += [float(not camera.straight), camera.k1, *(axes[2, :2] / axes[2, 2]), *axes.ravel()]
    values += [float(camera.square_aperture), *side, *growth]
    return np.array(values)


def _in_bands(draw: Callable[[int, int], None], rows: int) -> None:
    """Call `draw(first, last)` over all rows, in bands on all cores; the result does not depend on
    their number.
    """
    workers = os.cpu_count() or 1
    edges = np.linspace(0, rows, min(rows, 4 * workers) + 1).astype(int)
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(draw, edges[:-1].tolist(), edges[1:].tolist()))


def sensor(
    table: NDArray[np.float64],
    texels: NDArray[np.float32],
    background: tuple[float, float, float],
    camera: Camera,
    samples: int,
    seed: int,
) -> NDArray[np.float32]:
    """Mean radiance per sensor pixel, (H, W, 4) float32: R, G, B and the share of light a white
    scene would give.
    """
    picture = np.zeros((camera.height, camera.width, 4), np.float32)
    types = np.arange(len(camera.microlens_focal_lengths))
    lenses = np.column_stack(
        [1 / np.array(camera.microlens_focal_lengths), camera.half_apertures(types)]
    )
    args = (
        _camera_vector(camera),
        lenses,
        table,
        texels,
        np.array(background),
        _sequence(samples),
        seed,
    )
    _in_bands(lambda first, last: _sensor_rows(picture, first, last, *args), camera.height)
    return picture


def pinhole(
    table: NDArray[np.float64],
    texels: NDArray[np.float32],
    background: tuple[float, float, float],
    camera: Camera,
    affine: NDArray[np.float64],
    size: tuple[int, int],
    samples: int,
    seed: int,
) -> NDArray[np.float32]:
    """Pinhole picture from the main-lens centre, (h, w, 4) float32; pixel `(u, v)` lies at `X =
    affine @ (u, v, 1)`.
    """
    picture = np.zeros((size[1], size[0], 4), np.float32)
    args = (
        _camera_vector(camera),
        table,
        texels,
        np.array(background),
        affine,
        _sequence(samples),
        seed,
    )
    _in_bands(lambda first, last: _pinhole_rows(picture, first, last, *args), size[1])
    return picture


def nearest(
    table: NDArray[np.float64],
    texels: NDArray[np.float32],
    start: NDArray[np.float64],
    slope: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Depth [mm] of the nearest surface along rays that leave the main lens at `start` with
    `slope`, both (n, 2).

    NaN where nothing is hit.
    """
    depth = np.full(len(start), np.nan)
    _in_bands(
        lambda first, last: _nearest_rows(depth, first, last, start, slope, table, texels),
        len(start),
    )
    return depth


def _sequence(samples: int) -> NDArray[np.float64]:
    """(samples, 4) places of a ray: in the unit pixel, and on the unit disc of the microlens.

    They fill the four dimensions evenly (Roberts' additive recurrence of the golden-ratio family).
    """
    base = 1.0
    for _ in range(64):
        base = (1 + base) ** (1 / 5)
    even = np.mod(0.5 + np.arange(samples)[:, None] * base ** -np.arange(1.0, 5.0), 1.0)
    radius = np.sqrt(even[:, 2])
    angle = 2 * np.pi * even[:, 3]
    return np.column_stack([even[:, :2], radius * np.cos(angle), radius * np.sin(angle)])


@njit
def _hash(seed: int, x: int, y: int, k: int) -> float:
    """A number in 0..1 that looks random over its arguments (SplitMix64 finaliser)."""
    z = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(x) * np.uint64(
        0xBF58476D1CE4E5B9
    )
    z += np.uint64(y) * np.uint64(0x94D049BB133111EB) + np.uint64(k) * np.uint64(0xD6E8FEB86659FD93)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return np.float64(z >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@njit
def _wrapped(value):
    """A value in 0..2 brought to 0..1."""
    return value - 1.0 if value >= 1.0 else value


@njit(error_model="numpy")
def _bent(cam, x, y, slope_x, slope_y):
    """Start and slope in object space of a ray that leaves the array at `(x, y)` [mm] with a slope
    in its frame.

    Through the tilted array to the thin main lens; its distortion turns slopes, and starts by its
    derivative, so that the rays of a point still meet.
    """
    dx = cam[27] * slope_x + cam[28] * slope_y + cam[29]
    dy = cam[30] * slope_x + cam[31] * slope_y + cam[32]
    dz = cam[33] * slope_x + cam[34] * slope_y + cam[35]
    way = (cam[4] - cam[33] * x - cam[34] * y) / dz
    ax = cam[27] * x + cam[28] * y + dx * way
    ay = cam[30] * x + cam[31] * y + dy * way
    sx = dx / dz - ax / cam[3]
    sy = dy / dz - ay / cam[3]
    k1 = cam[24]
    gain = 1 + k1 * (sx * sx + sy * sy)
    inner = 2 * k1 * (sx * ax + sy * ay)
    return ax, ay, gain * ax + inner * sx, gain * ay + inner * sy, gain * sx, gain * sy


@njit(error_model="numpy")
def _passes(cam, ax, ay, half):
    """Whether a ray through `(ax, ay)` of the main lens passes its aperture of this half width."""
    if cam[36] == 0:
        return ax * ax + ay * ay <= half * half
    return max(abs(ax * cam[37] + ay * cam[38]), abs(ay * cam[37] - ax * cam[38])) <= half


@njit(error_model="numpy")
def _through_lens(
    total, x, y, cam, cx, cy, power, half, table, texels, background, points, shift, chosen
):
    """Add the light that reaches pixel `(x, y)` through a microlens at `(cx, cy)` [mm]."""
    pixel = cam[0]
    focal = cam[3]
    dl = cam[4]
    px = (x - cam[1]) * pixel
    py = (y - cam[2]) * pixel
    # The cosine of the tilt of the sensor is left out.
    b = cam[5] + cam[39] * px + cam[40] * py
    # A ray from sensor point `p` over microlens point `c + r` leaves the lens with slope (c + r -
    # p) / b - r * power.
    bend = 1 / b - power
    slope_x = (cx - px) / b
    slope_y = (cy - py) / b
    ax = cx + slope_x * dl
    ay = cy + slope_y * dl
    corner = 0.71 * pixel
    lens = cam[7]
    start_spread = corner * dl / b + lens * abs(1 + bend * dl)
    slope_spread = corner * abs(1 / b - dl / (b * focal)) + lens * abs(
        bend - (1 + bend * dl) / focal
    )
    mx = slope_x - ax / focal
    my = slope_y - ay / focal
    ox = ax
    oy = ay
    if cam[23] > 0:
        px = px - b * cam[25]
        py = py - b * cam[26]
        _, _, ox, oy, mx, my = _bent(cam, cx, cy, (cx - px) / b, (cy - py) / b)
        start_spread = 2 * start_spread
        slope_spread = 2 * slope_spread
    count = choose(chosen, table, ox, oy, mx, my, start_spread, slope_spread)
    cosine = lens * math.cos(2 * math.pi * shift[2])
    sine = lens * math.sin(2 * math.pi * shift[2])
    per_b = 1 / b
    per_focal = 1 / focal
    share = 1.0 / len(points)
    # One weight for all rays: of weights of their own the middle would lie beside the chief ray,
    # and so would features.
    if cam[19] > 0:
        share /= (1 + slope_x * slope_x + slope_y * slope_y) ** 2
    for k in range(len(points)):
        ux = px + (_wrapped(points[k, 0] + shift[0]) - 0.5) * pixel
        uy = py + (_wrapped(points[k, 1] + shift[1]) - 0.5) * pixel
        rx = cosine * points[k, 2] - sine * points[k, 3]
        ry = sine * points[k, 2] + cosine * points[k, 3]
        sx = (cx + rx - ux) * per_b
        sy = (cy + ry - uy) * per_b
        sx = sx - rx * power
        sy = sy - ry * power
        if cam[23] > 0:
            ax, ay, ox, oy, sx, sy = _bent(cam, cx + rx, cy + ry, sx, sy)
            if _passes(cam, ax, ay, half):
                found, _, u, v = hit(table, texels, chosen, count, ox, oy, sx, sy)
                add_light(total, table, texels, background, found, u, v, share)
            continue
        ax = cx + rx + sx * dl
        ay = cy + ry + sy * dl
        if not _passes(cam, ax, ay, half):
            continue
        sx = sx - ax * per_focal
        sy = sy - ay * per_focal
        qx = ax + sx * cam[20]
        qy = ay + sy * cam[20]
        if cam[21] > 0 and qx * qx + qy * qy > cam[21] * cam[21]:
            continue
        found, _, u, v = hit(table, texels, chosen, count, ax, ay, sx, sy)
        add_light(total, table, texels, background, found, u, v, share)


@kernel(error_model="numpy")
def _sensor_rows(picture, first, last, cam, lenses, table, texels, background, points, seed):
    """Sum the light of all microlenses that can reach each pixel of rows `first` to `last`."""
    chosen = np.empty(len(table), np.int64)
    shift = np.empty(3)
    total = np.empty(4)
    reach = cam[22] + _HALF_DIAGONAL
    for y in range(first, last):
        for x in range(picture.shape[1]):
            total[:] = 0.0
            for k in range(3):
                shift[k] = _hash(seed, x, y, k)
            dx = x - cam[8]
            dy = y - cam[9]
            low_i = math.floor(dx * cam[14] + dy * cam[16]) - 1
            low_j = math.floor(dx * cam[15] + dy * cam[17]) - 1
            for j in range(low_j, low_j + 4):
                for i in range(low_i, low_i + 4):
                    ex = cam[8] + i * cam[10] + j * cam[12]
                    ey = cam[9] + i * cam[11] + j * cam[13]
                    if (x - ex) ** 2 + (y - ey) ** 2 > reach * reach:
                        continue
                    cx = (ex - cam[1]) * cam[0] / cam[18]
                    cy = (ey - cam[2]) * cam[0] / cam[18]
                    power, half = lenses[(i - j) % len(lenses)]
                    _through_lens(
                        total,
                        x,
                        y,
                        cam,
                        cx,
                        cy,
                        power,
                        half,
                        table,
                        texels,
                        background,
                        points,
                        shift,
                        chosen,
                    )
            for k in range(4):
                picture[y, x, k] = total[k]


@kernel(error_model="numpy")
def _pinhole_rows(picture, first, last, cam, table, texels, background, affine, points, seed):
    """Mean radiance over each output pixel for rays through the main-lens centre."""
    chosen = np.empty(len(table), np.int64)
    shift = np.empty(2)
    total = np.empty(4)
    scale = cam[0] / (cam[18] * cam[4])
    room = (
        _HALF_DIAGONAL
        * scale
        * max(abs(affine[0, 0]) + abs(affine[1, 0]), abs(affine[0, 1]) + abs(affine[1, 1]))
    )
    for y in range(first, last):
        for x in range(picture.shape[1]):
            total[:] = 0.0
            shift[0], shift[1] = _hash(seed, x, y, 0), _hash(seed, x, y, 1)
            for k in range(-1, len(points)):
                u = float(x)
                v = float(y)
                if k >= 0:
                    u += _wrapped(points[k, 0] + shift[0]) - 0.5
                    v += _wrapped(points[k, 1] + shift[1]) - 0.5
                sx = -(affine[0, 0] * u + affine[0, 1] * v + affine[0, 2] - cam[1]) * scale
                sy = -(affine[1, 0] * u + affine[1, 1] * v + affine[1, 2] - cam[2]) * scale
                if k < 0:
                    count = choose(chosen, table, 0.0, 0.0, sx, sy, 0.0, room)
                    continue
                found, _, tu, tv = hit(table, texels, chosen, count, 0.0, 0.0, sx, sy)
                add_light(total, table, texels, background, found, tu, tv, 1.0 / len(points))
            for k in range(4):
                picture[y, x, k] = total[k]


@kernel(error_model="numpy")
def _nearest_rows(depth, first, last, start, slope, table, texels):
    """Depth along each ray `first` to `last`."""
    chosen = np.empty(len(table), np.int64)
    for n in range(first, last):
        ax = start[n, 0]
        ay = start[n, 1]
        sx = slope[n, 0]
        sy = slope[n, 1]
        count = choose(chosen, table, ax, ay, sx, sy, 0.0, 0.0)
        found, z, _, _ = hit(table, texels, chosen, count, ax, ay, sx, sy)
        if found >= 0:
            depth[n] = z
