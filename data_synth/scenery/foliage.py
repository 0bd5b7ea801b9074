"""Branches and leaves as cut-out textures: (h, w, 4) float32, the fourth channel 1 where there is
wood or leaf.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .textures import fractal_noise, linear, tint

__all__ = ["branches", "leaf_mass"]

# Boughs end in twigs of this thickness, in leaf lengths.
_TWIG = 0.25
_BARK = ((92, 70, 50), (70, 54, 40), (112, 90, 66), (58, 48, 44))


def branches(
    shape: tuple[int, int],
    rng: np.random.Generator,
    roots: list[tuple[float, float, float]],
    *,
    thickness: float,
    leaf: float,
) -> NDArray[np.float32]:
    """Forking branches with leaves at their tips.

    Parameters
    ----------
    shape : (int, int)
        Height and width in texels.
    roots : list of (x, y, angle)
        Where the boughs begin, as shares of width and height, and their direction [rad], y down.
    thickness : float [texel]
        Width of a bough at its root.
    leaf : float [texel]
        Length of a leaf, 0 for bare branches.
    """
    height, width = shape
    colour = np.empty((height, width, 3), np.uint8)
    colour[:] = _BARK[0]
    mask = np.zeros((height, width), np.uint8)
    for x, y, angle in roots:
        _grow(colour, mask, np.array([x * width, y * height]), angle, thickness, leaf, rng)
    return _cut_out(colour, mask, rng)


def leaf_mass(
    shape: tuple[int, int], rng: np.random.Generator, cover: NDArray[np.float32], *, leaf: float
) -> NDArray[np.float32]:
    """A thicket of leaves, dense where `cover` (h', w') is 1 and absent where it is 0."""
    height, width = shape
    share = cv2.resize(cover, (width, height), interpolation=cv2.INTER_LINEAR)
    colour = np.empty((height, width, 3), np.uint8)
    colour[:] = (40, 80, 30)
    mask = np.zeros((height, width), np.uint8)
    for _ in range(round(2.2 * height * width / (0.3 * leaf * leaf))):
        x = rng.random() * width
        y = rng.random() * height
        if rng.random() < share[int(y), int(x)]:
            _leaf(
                colour,
                mask,
                np.array([x, y]),
                rng.random() * 2 * np.pi,
                leaf * rng.uniform(0.5, 1.3),
                rng,
            )
    return _cut_out(colour, mask, rng)


def _cut_out(
    colour: NDArray[np.uint8], mask: NDArray[np.uint8], rng: np.random.Generator
) -> NDArray[np.float32]:
    skin = tint(linear(colour), fractal_noise(mask.shape, rng, coarsest=24, persistence=0.75), 0.4)
    return np.dstack([skin, mask.astype(np.float32) / 255]).astype(np.float32)


def _grow(
    colour: NDArray[np.uint8],
    mask: NDArray[np.uint8],
    at: NDArray[np.float64],
    angle: float,
    thickness: float,
    leaf: float,
    rng: np.random.Generator,
) -> None:
    """Draw one bough in short pieces that taper, bend and fork."""
    length = 0.0
    while thickness > max(1.6, _TWIG * leaf):
        step = 1.6 * thickness + 3
        angle += 0.16 * rng.standard_normal()
        to = at + step * np.array([np.cos(angle), np.sin(angle)])
        _limb(colour, mask, at, to, thickness, rng)
        at = to
        length = length + step
        thickness *= 0.965
        if thickness < 0.45 * leaf and rng.random() < 0.3:
            _leaf(colour, mask, at, angle + rng.choice([-1, 1]) * rng.uniform(0.5, 1.4), leaf, rng)
        if rng.random() < 0.05:
            turn = rng.choice([-1, 1]) * rng.uniform(0.4, 0.9)
            _grow(colour, mask, at, angle + turn, thickness * rng.uniform(0.5, 0.75), leaf, rng)
        if not (-step < at[0] < mask.shape[1] + step and -step < at[1] < mask.shape[0] + step):
            return


def _limb(
    colour: NDArray[np.uint8],
    mask: NDArray[np.uint8],
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    thickness: float,
    rng: np.random.Generator,
) -> None:
    """One straight piece of a bough: bark with streaks along it."""
    p, q = (tuple(np.rint(16 * v).astype(int).tolist()) for v in (start, end))
    cv2.line(
        colour, p, q, _BARK[int(rng.integers(2))], max(1, round(thickness)) + 2, cv2.LINE_AA, 4
    )
    cv2.line(mask, p, q, 255, max(1, round(thickness)), cv2.LINE_AA, 4)
    across = np.array([start[1] - end[1], end[0] - start[0]]) / max(np.hypot(*(end - start)), 1e-9)
    for _ in range(max(2, round(thickness / 3))):
        aside = across * thickness * rng.uniform(-0.45, 0.45)
        a, b = (tuple(np.rint(16 * (v + aside)).astype(int).tolist()) for v in (start, end))
        cv2.line(
            colour, a, b, _BARK[int(rng.integers(4))], max(1, round(thickness / 7)), cv2.LINE_AA, 4
        )


def _leaf(
    colour: NDArray[np.uint8],
    mask: NDArray[np.uint8],
    at: NDArray[np.float64],
    angle: float,
    length: float,
    rng: np.random.Generator,
) -> None:
    """A pointed leaf with a light vein."""
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    t = np.linspace(0, 1, 9)
    bulge = 0.28 * np.sin(np.pi * t**0.8)
    edge = (
        np.concatenate([np.column_stack([t, bulge]), np.column_stack([t, -bulge])[::-1]]) * length
    )
    outline = np.rint(16 * (at + edge[:, :1] * along + edge[:, 1:] * across)).astype(np.int32)
    green = int(rng.integers(80, 190))
    tone = (int(green * rng.uniform(0.3, 0.85)), green, int(rng.integers(20, 70)))
    cv2.fillPoly(colour, [outline], tone, cv2.LINE_AA, 4)
    cv2.fillPoly(mask, [outline], 255, cv2.LINE_AA, 4)
    p, q = (
        tuple(np.rint(16 * (at + s * length * along)).astype(int).tolist()) for s in (0.05, 0.9)
    )
    cv2.line(
        colour,
        p,
        q,
        tuple(min(255, c + 60) for c in tone),
        max(1, round(length / 14)),
        cv2.LINE_AA,
        4,
    )
