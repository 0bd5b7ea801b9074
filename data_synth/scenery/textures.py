"""Procedural textures with detail at every scale, as linear radiance (h, w, 3) float32 in 0..1."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..transfer import from_srgb

__all__ = ["bricks", "dead_leaves", "fractal_noise", "linear", "text_page", "tint"]

_LINEAR = from_srgb(np.arange(256) / 255.0).astype(np.float32)
Colour = tuple[float, float, float]


def linear(drawn: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Linear radiance of an 8-bit sRGB drawing."""
    return _LINEAR[drawn]


def fractal_noise(
    shape: tuple[int, int],
    rng: np.random.Generator,
    *,
    coarsest: float = 128.0,
    persistence: float = 0.7,
) -> NDArray[np.float32]:
    """Sum of random grids of halving cell size, mean 0 and standard deviation 1.

    Parameters
    ----------
    shape : (int, int)
        Height and width in texels.
    coarsest : float [texel]
        Largest cell; the finest is one texel.
    persistence : float
        Amplitude of an octave over that of the next coarser one.
    """
    height, width = shape
    total = np.zeros(shape, np.float32)
    cell = float(coarsest)
    amplitude = 1.0
    while cell >= 1:
        grid = rng.standard_normal(
            (int(height / cell) + 3, int(width / cell) + 3), dtype=np.float32
        )
        # Cut at an arbitrary place of the cell: octaves that share grid lines would leave a lattice
        # of their own.
        fine = cv2.resize(grid, None, fx=cell, fy=cell, interpolation=cv2.INTER_CUBIC)
        top, left = (int(v) for v in rng.integers(0, max(int(cell), 1), 2))
        total += amplitude * fine[top : top + height, left : left + width]
        cell = cell / 2
        amplitude = amplitude * persistence
    return (total - total.mean()) / max(float(total.std()), 1e-6)


def tint(
    radiance: NDArray[np.float32], noise: NDArray[np.float32], strength: float
) -> NDArray[np.float32]:
    """Multiply a texture by `exp(strength * noise)`, kept in 0..1."""
    return np.clip(radiance * np.exp(strength * noise)[..., None], 0.0, 1.0).astype(np.float32)


def dead_leaves(
    shape: tuple[int, int],
    rng: np.random.Generator,
    *,
    smallest: float = 3.0,
    largest: float = 150.0,
) -> NDArray[np.float32]:
    """Opaque discs with power-law radii over each other, each with a grain: the statistics of
    natural pictures.

    Parameters
    ----------
    smallest, largest : float [texel]
        Range of the radii.
    """
    height, width = shape
    canvas = np.empty((height, width, 3), np.uint8)
    canvas[:] = 128
    # A density of radii falling with the cube makes every scale cover the same area.
    covered = 0.0
    radii = []
    while covered < 3.0 * height * width:
        batch = (largest**-2 + rng.random(4096) * (smallest**-2 - largest**-2)) ** -0.5
        covered += float(np.pi * (batch**2).sum())
        radii.append(batch)
    sizes = np.concatenate(radii)
    centres = rng.random((len(sizes), 2)) * (width, height)
    # Mostly light and dark, some colour: correlations must not live on hue alone.
    colours = rng.integers(20, 236, (len(sizes), 1)) + rng.normal(0, 28, (len(sizes), 3))
    colours = np.clip(np.rint(colours), 0, 255).astype(int)
    angles = rng.integers(0, 180, len(sizes))
    for k in range(len(sizes)):
        axes = (round(sizes[k] * 16), round(sizes[k] * 10))
        at = (round(centres[k, 0] * 16), round(centres[k, 1] * 16))
        _ellipse(canvas, at, axes, float(angles[k]), colours[k].tolist())
    return tint(linear(canvas), fractal_noise(shape, rng, coarsest=32), 0.25)


def _ellipse(
    canvas: NDArray[np.uint8], at: tuple[int, int], axes: tuple[int, int], angle: float, colour: Any
) -> None:
    """Filled ellipse at 1/16 texel."""
    outline = cv2.ellipse2Poly((0, 0), axes, round(angle), 0, 360, 12)
    cv2.fillConvexPoly(canvas, outline + np.array(at, np.int32), colour, cv2.LINE_AA, 4)


def bricks(
    shape: tuple[int, int], rng: np.random.Generator, *, course: float = 24.0
) -> NDArray[np.float32]:
    """A brick wall with mortar, bricks of many colours and a rough surface.

    Parameters
    ----------
    course : float [texel]
        Height of one course.
    """
    height, width = shape
    rows, columns = np.mgrid[0:height, 0:width].astype(np.float32)
    layer = np.floor(rows / course)
    shift = rng.random(int(layer.max()) + 1).astype(np.float32)[layer.astype(int)] * 0.3 + 0.5 * (
        layer % 2
    )
    along = columns / (2.4 * course) + shift
    stone = np.floor(along)
    number = (layer.astype(np.int64) * 7919 + stone.astype(np.int64) * 104729) % 4099
    palette = np.array(
        [
            (178, 84, 68),
            (150, 62, 52),
            (196, 110, 84),
            (128, 70, 62),
            (204, 138, 110),
            (112, 58, 78),
        ]
    )
    colours = palette[rng.integers(0, len(palette), 4099)] + rng.normal(0, 14, (4099, 3))
    wall = linear(np.clip(colours, 0, 255).astype(np.uint8))[number]
    joint = 0.09
    mortar = ((rows / course - layer) < joint) | ((along - stone) < joint / 2.4)
    wall[mortar] = linear(np.array((190, 182, 170), np.uint8))
    return tint(wall, fractal_noise(shape, rng, coarsest=64, persistence=0.75), 0.22)


def text_page(
    shape: tuple[int, int],
    rng: np.random.Generator,
    *,
    ink: Colour = (24, 24, 60),
    paper: Colour = (236, 228, 208),
    size: float = 1.0,
) -> NDArray[np.float32]:
    """Lines of letters of several sizes on rough paper.

    Parameters
    ----------
    size : float
        Letter height in units of about 20 texels.
    """
    height, width = shape
    page = np.empty((height, width, 3), np.uint8)
    page[:] = paper
    letters = np.array(list("ABCDEFGHKLMNPRSTUVWXYZaeghkmnrst0123456789  "))
    baseline = 4.0
    while baseline < height + 40:
        scale = size * float(rng.choice([0.6, 0.8, 1.0, 1.5]))
        baseline += 28 * scale
        line = "".join(rng.choice(letters, int(width / (14 * scale)) + 4))
        start = (-int(rng.integers(0, 20)), int(baseline))
        cv2.putText(
            page,
            line,
            start,
            cv2.FONT_HERSHEY_DUPLEX,
            0.9 * scale,
            ink,
            max(1, round(1.6 * scale)),
            cv2.LINE_AA,
        )
    return tint(linear(page), fractal_noise(shape, rng, coarsest=64), 0.15)
