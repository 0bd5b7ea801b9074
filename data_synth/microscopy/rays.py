"""Flats of a microscope by tracing rays from pixels through microlens, tube lens and objective.

Every ray is refracted at three surfaces: a thin microlens, a thin tube lens, and an objective that
obeys the sine condition of Abbe. In the medium it is straight; its light is the length of its way
through the specimen.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lfcal.runtime.kernels import kernel

from .capture import MicroscopeCapture, photograph
from .microscope import Microscope
from .specimen import Specimen

__all__ = ["trace_flat"]

# Focal length of the tube lens [um]; it cancels, so any value will do.
_TUBE_LENGTH = 200_000.0
# Tables of random places that pixels take in turn; a prime, so that columns do not repeat.
_TABLES = 997


@njit
def _way_inside(origin_x, origin_y, slope_x, slope_y, ball):
    """Length of the part of a ray within a hollow ball: x, y, z, outer radius, inner radius,
    brightness."""
    length = np.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    ax = origin_x - ball[0]
    ay = origin_y - ball[1]
    az = -ball[2]
    along = (ax * slope_x + ay * slope_y + az) / length
    apart2 = ax * ax + ay * ay + az * az - along * along
    way = 2.0 * np.sqrt(max(ball[3] * ball[3] - apart2, 0.0))
    return way - 2.0 * np.sqrt(max(ball[4] * ball[4] - apart2, 0.0))


@kernel(share=lambda balls, optics, centres, points, out: len(out))
def _trace(begin, end, balls, optics, centres, points, out):
    """Rows of a flat (h, w): the mean over points of each pixel and each microlens that may light
    it.

    `points` (m, samples, 4) are tables of places on pixel and microlens, from -0.5 to 0.5, which
    pixels take in turn.
    """
    pixel, focal, tube, objective, na, index, side, uniform = optics
    # Where the optical axis meets the sensor [um].
    middle_x = (out.shape[1] - 1) / 2 * pixel
    middle_y = (out.shape[0] - 1) / 2 * pixel
    for y in range(begin, end):
        for x in range(out.shape[1]):
            total = 0.0
            for number in range(centres.shape[2]):
                lens = centres[y, x, number]
                table = points[((y * out.shape[1] + x) * centres.shape[2] + number) % len(points)]
                for place in table:
                    # On the sensor, and on the square aperture of the microlens [um].
                    px = (x + place[0]) * pixel
                    py = (y + place[1]) * pixel
                    turned_x = place[2] * side
                    turned_y = place[3] * side
                    ux = lens[0] + lens[2] * turned_x - lens[3] * turned_y
                    uy = lens[1] + lens[3] * turned_x + lens[2] * turned_y
                    # Slopes from the sensor on; the microlens bends them.
                    sx = (ux - px) / focal - (ux - lens[0]) / focal
                    sy = (uy - py) / focal - (uy - lens[1]) / focal
                    # To the tube lens, and a focal length behind it, where the aperture stop is.
                    tx = ux - middle_x + sx * tube
                    ty = uy - middle_y + sy * tube
                    bent_x = sx - tx / tube
                    bent_y = sy - ty / tube
                    sine_x = (tx + bent_x * tube) / (index * objective)
                    sine_y = (ty + bent_y * tube) / (index * objective)
                    sine2 = sine_x * sine_x + sine_y * sine_y
                    if sine2 > (na / index) * (na / index):
                        continue
                    if uniform:
                        total += 1.0
                        continue
                    cosine = np.sqrt(1.0 - sine2)
                    # Object space is turned by 180 degrees, so that it is upright on the flat.
                    place_x = -bent_x * objective
                    place_y = -bent_y * objective
                    slope_x = -sine_x / cosine
                    slope_y = -sine_y / cosine
                    for ball in balls:
                        total += ball[5] * _way_inside(place_x, place_y, slope_x, slope_y, ball)
            out[y, x] = total / points.shape[1]


def trace_flat(
    specimen: Specimen,
    microscope: Microscope,
    *,
    samples: int = 64,
    seed: int = 0,
    electrons: float | None = None,
    read: float = 2.0,
) -> MicroscopeCapture:
    """Photograph a specimen by tracing rays, with a white image of an even field.

    Parameters
    ----------
    specimen : Specimen
    microscope : Microscope
    samples : int
        Rays per pixel and microlens that may light it.
    seed : int
    electrons : float, optional
        Of the brightest pixel, for photon noise; without noise by default.
    read : float [electrons]
        Read-out noise.

    Examples
    --------
    >>> from data_synth.microscopy import Microscope, Specimen, trace_flat
    >>> capture = trace_flat(Specimen.beads([[0, 0, 2]], 0.5), Microscope(lenses=(9, 9)), samples=2)
    >>> capture.white.shape
    (139, 139)
    """
    if samples < 1:
        raise ValueError(f"samples must be at least 1, got {samples}")
    rng = np.random.default_rng(seed)
    balls = np.column_stack([specimen.centres, specimen.outer, specimen.inner, specimen.brightness])
    light = _traced(balls, microscope, samples, rng, uniform=False)
    white = _traced(balls[:0], microscope, samples, rng, uniform=True)
    return photograph(light, white, specimen, microscope, (electrons, read), rng)


def _traced(
    balls: NDArray[np.float64],
    microscope: Microscope,
    samples: int,
    rng: np.random.Generator,
    uniform: bool,
) -> NDArray[np.float64]:
    """(h, w) light of the pixels."""
    width, height = microscope.size
    index, _ = microscope.nearest_lenses(np.arange(width), np.arange(height))
    # The lens above a pixel, and those around it.
    steps = np.array([[i, j] for i in (-1, 0, 1) for j in (-1, 0, 1)])
    index = (index[:, None] + steps).reshape(-1, 2)
    turn = np.radians(microscope.rotation)
    lenses = np.empty((len(index), 4))
    lenses[:, :2] = microscope.lattice.points(index) * microscope.pixel
    lenses[:, 2:] = np.cos(turn), np.sin(turn)
    centres = lenses.reshape(height, width, len(steps), 4)
    objective = _TUBE_LENGTH / microscope.magnification
    optics = (
        microscope.pixel,
        microscope.microlens_focal_length,
        _TUBE_LENGTH,
        objective,
        microscope.na,
        microscope.medium_index,
        microscope.pitch * microscope.pixel,
        uniform,
    )
    out = np.empty((height, width))
    points = rng.random((_TABLES, samples, 4)) - 0.5
    _trace(balls, optics, centres, points, out)
    return out
