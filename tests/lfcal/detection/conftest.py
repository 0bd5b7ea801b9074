"""Photographs of repeating patterns for the tests of detection."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest


def _rotate(degrees, size):
    """Coordinates u, v (h, w) [px] of the pixels of a picture of `size` (width, height), rotated
    about its corner.
    """
    y, x = np.mgrid[0 : size[1], 0 : size[0]].astype(float)
    cos = np.cos(np.radians(degrees))
    sin = np.sin(np.radians(degrees))
    return cos * x + sin * y, cos * y - sin * x


def _photograph(picture, blur=0.7, noise=3.0, seed=0):
    """A picture of 8 bits, blurred and with noise."""
    picture = cv2.GaussianBlur(picture, (0, 0), blur) if blur else picture
    return np.clip(
        picture + np.random.default_rng(seed).normal(0, noise, picture.shape), 0, 255
    ).astype(np.uint8)


def _draw_board(degrees, side, size):
    """0 and 1 in the squares of a checkerboard."""
    u, v = _rotate(degrees, size)
    return (np.floor(u / side) + np.floor(v / side)) % 2


def _draw_bricks(degrees, width, height, mortar, size):
    """Where the mortar of a brick wall is."""
    u, v = _rotate(degrees, size)
    row = np.floor(v / height)
    return ((u + row % 2 * width / 2) % width < mortar) | (v % height < mortar)


def _draw_weave(degrees, period, twill, size):
    """Light on the threads of a plain weave or a twill, 0..1."""
    u, v = _rotate(degrees, size)
    i = np.floor(u / period)
    j = np.floor(v / period)
    along = np.cos(np.pi * (u / period - i - 0.5))
    across = np.cos(np.pi * (v / period - j - 0.5))
    over = (i - j) % 4 < 2 if twill else (i + j) % 2 > 0
    return np.where(over, across * (0.75 + 0.25 * along), along * (0.75 + 0.25 * across))


@pytest.fixture(scope="session")
def patterns():
    """Functions that draw and photograph patterns."""
    return SimpleNamespace(
        rotate=_rotate,
        photograph=_photograph,
        board=_draw_board,
        bricks=_draw_bricks,
        weave=_draw_weave,
    )
