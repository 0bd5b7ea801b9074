"""Blur by depth, for refocused pictures whose light field is undersampled.

Out of focus, each lens draws a scene point at another place. Where these images lie some pixels of
the flat apart, detail is repeated and blur becomes a mesh of the lattice. The depth is known:
there, the picture that is sharp everywhere is blurred instead, in layers from far to near.

In a picture in focus at the virtual depth `v0 = D / s0`, a lens at the distance `d` from a place
draws the point at the virtual depth `v` moved by `d (v - v0) / v0`, neighbours by `D` in place of
`d`; a pixel of the flat is `|v0|` wide there. The lenses that draw a place reach as far as
`R |v0|`, so that a point is blurred over a disc of the radius `R |v - v0|`.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["DepthBlur"]

# [px of the flat] Images of neighbouring lenses this far apart begin to be replaced, and at twice
# the distance they are: a lower limit replaces blur that is even already, a higher one leaves a
# mesh.
_APART = 2.0
# Most layers, whose blur differs by a pixel or more, and the share of the pixels that may lie
# before and behind all of them, which are mostly errors of the depth.
_LAYERS = 24
_BEYOND = 0.005


@dataclass(frozen=True)
class DepthBlur:
    """A picture that is sharp everywhere, and what its blur needs."""

    sharp: NDArray[np.float32]  # (h, w, C)
    depth: NDArray[np.float32]  # (h, w) signed virtual depth `D / s`
    scale: float  # [px per pitch] of the picture
    radius: float  # [px of the flat] of what is read of the microimages
    pitch: float  # [px of the flat]

    def mend(self, picture: NDArray[np.float32], focus: float) -> NDArray[np.float32]:
        """A refocused picture (h, w, C) in focus at the virtual depth `focus`, with even blur."""
        share = self._undersampled(focus)[..., None]
        if not share.any():
            return picture
        return np.asarray(picture + share * (self.blurred(focus) - picture), np.float32)

    def _undersampled(self, focus: float) -> NDArray[np.float32]:
        """(h, w) 0 where images of neighbouring lenses coincide, 1 where they are far apart."""
        beyond = self.depth - np.float32(focus)
        apart = np.abs(beyond) * np.float32(self.pitch / focus**2)
        side = 2 * int(np.ceil(self.scale)) + 1
        # What is blurred before the plane in focus shows what lies behind it, within a pitch.
        behind = cv2.erode(apart, np.ones((side, side), np.uint8))
        apart = np.where(beyond < 0, behind, apart)
        share = np.clip(apart / _APART - 1, 0, 1).astype(np.float32)
        return np.asarray(cv2.blur(share, (side, side)), np.float32)

    def blurred(self, focus: float) -> NDArray[np.float32]:
        """(h, w, C) the sharp picture, each depth blurred over its disc, near ones before far."""
        radii = self.scale * self.radius / self.pitch * (self.depth - np.float32(focus))
        near, far = np.quantile(radii, [_BEYOND, 1 - _BEYOND])
        count = int(np.clip(np.ceil(far - near), 1, _LAYERS))
        step = max(float(far - near), 1e-6) / count
        place = (far - np.clip(radii, near, far)) / step
        drawn = np.zeros((*self.depth.shape, self.sharp.shape[2] + 1), np.float32)
        for number in range(count + 1):
            # Between two layers, a pixel belongs to both.
            mask = np.maximum(1 - np.abs(place - number), 0).astype(np.float32)[..., None]
            layer = np.concatenate([self.sharp * mask, mask], axis=2)
            disc = _disc(abs(far - number * step))
            layer = cv2.filter2D(layer, -1, disc, borderType=cv2.BORDER_REFLECT_101)
            drawn = drawn * (1 - layer[..., -1:]) + layer
        # What near places hide has no colour, and what is left counts in full.
        return np.asarray(drawn[..., :-1] / np.maximum(drawn[..., -1:], 1e-6), np.float32)


def _disc(radius: float) -> NDArray[np.float32]:
    """(n, n) an even disc with a sum of 1, its rim a pixel wide."""
    reach = int(np.ceil(radius))
    across = np.arange(-reach, reach + 1)
    distance = np.hypot(across, across[:, None])
    disc = np.clip(radius + 0.5 - distance, 0, 1)
    return np.asarray(disc / disc.sum(), np.float32)
