"""What lies under the simulated microscope: beads and shells that fluoresce, and the volume that
they fill."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Specimen"]

Array = NDArray[np.float64]

# Powers of the inverse of the root of x^4 = x + 1: the steps of the recurrence that fills a cube.
_STEPS = 1.2207440846057596 ** -np.arange(1.0, 4.0)


@dataclass(frozen=True)
class Specimen:
    """Hollow balls of even brightness in a clear medium; beads are those without a hole.

    x and y [um] run as columns and rows of the flat, from its middle; z grows from the native plane
    towards the objective.

    Parameters
    ----------
    centres : (n, 3) float64 [um]
    outer, inner : (n,) float64 [um]
        Radii of each ball and of the hole in it.
    brightness : (n,) float64
        Light per volume.

    Examples
    --------
    >>> from data_synth.microscopy import Specimen
    >>> beads = Specimen.beads([[0, 0, 3], [5, 2, -4]], radius=0.5)
    >>> len(beads.centres), beads.at([[0, 0, 3], [0, 0, 0]]).tolist()
    (2, [1.0, 0.0])
    """

    centres: Array
    outer: Array
    inner: Array
    brightness: Array = field(default_factory=lambda: np.ones(1))

    @classmethod
    def beads(cls, centres: ArrayLike, radius: float) -> Specimen:
        """Beads of one radius [um]."""
        places = np.atleast_2d(np.array(centres, float))
        count = len(places)
        return cls(places, np.full(count, float(radius)), np.zeros(count), np.ones(count))

    @classmethod
    def shell(
        cls, radius: float, thickness: float, centre: ArrayLike = (0.0, 0.0, 0.0)
    ) -> Specimen:
        """One shell, such as the membrane of a vesicle; `radius` [um] is that of its middle."""
        place = np.array(centre, float)[None]
        return cls(
            place,
            np.array([radius + thickness / 2]),
            np.array([radius - thickness / 2]),
            np.ones(1),
        )

    def __add__(self, other: Specimen) -> Specimen:
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Specimen(*(np.concatenate(pair) for pair in pairs))

    def at(self, points: ArrayLike) -> Array:
        """(n,) brightness at points (n, 3) [um]."""
        places = np.atleast_2d(np.array(points, float))
        total = np.zeros(len(places))
        for centre, outer, inner, light in zip(
            self.centres, self.outer, self.inner, self.brightness, strict=True
        ):
            away = np.linalg.norm(places - centre, axis=1)
            total += light * ((away <= outer) & (away >= inner))
        return total

    def volume(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, inside: int = 3
    ) -> NDArray[np.float32]:
        """(z, y, x) mean brightness of the voxels of a regular grid about places x, y, z [um].

        Each is the mean over `inside` points along every axis.
        """
        axes = [np.asarray(axis, float) for axis in (z, y, x)]
        part = (np.arange(inside) + 0.5) / inside - 0.5
        total = np.zeros([len(axis) for axis in axes], np.float32)
        steps = [axis[1] - axis[0] if len(axis) > 1 else 1.0 for axis in axes]
        for shift in np.stack(np.meshgrid(part, part, part), -1).reshape(-1, 3):
            moved = [axis + step * by for axis, step, by in zip(axes, steps, shift, strict=True)]
            for plane, depth in enumerate(moved[0]):
                across, down = np.meshgrid(moved[2], moved[1])
                points = np.stack([across, down, np.full_like(across, depth)], -1).reshape(-1, 3)
                total[plane] += self.at(points).reshape(across.shape)
        return total / np.float32(inside**3)

    def points(self, spacing: float, rng: np.random.Generator) -> tuple[Array, Array]:
        """Points (n, 3) [um] spread evenly over all balls, one for each cube of `spacing` [um], and
        their light (n,).

        They follow an additive recurrence (Roberts 2018), which leaves neither gaps nor clusters.
        """
        places = []
        light = []
        for centre, outer, inner, bright in zip(
            self.centres, self.outer, self.inner, self.brightness, strict=True
        ):
            volume = 4 / 3 * np.pi * (outer**3 - inner**3)
            count = max(1, round(volume / spacing**3))
            parts = (rng.random(3) + np.arange(count)[:, None] * _STEPS) % 1
            radius = np.cbrt(inner**3 + parts[:, 0] * (outer**3 - inner**3))
            height = 2 * parts[:, 1] - 1
            turn = 2 * np.pi * parts[:, 2]
            across = np.sqrt(1 - height**2)
            direction = np.column_stack([across * np.cos(turn), across * np.sin(turn), height])
            places.append(centre + radius[:, None] * direction)
            light.append(np.full(count, bright * volume / count))
        return np.concatenate(places), np.concatenate(light)
