"""Microimages of square and rectangular cells with straight edges, and dark gaps between them.

The light of a pixel is the product of two profiles, of its distances from the two middle lines of
its cell: a profile over the distance from the centre cannot follow straight edges. Profiles are
even, so that centres are those between opposite edges.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from ..lattice.lattice import Lattice
from ..lattice.robust_fit import TUKEY_CUTOFF
from ..microimage.average import ProfilePlaces, average_profile, estimate_variance
from ..runtime.arrays import Floats
from .kernel import Sums
from .microimages import Microimages

__all__ = ["SquareMicroimages"]

# [px] between samples of the profiles.
_STEP = 0.125
# Pixels that are used: with them centres are right to a thousandth of a pixel.
_PIXELS = 6e5
# Share of the cell beside its middle line in which a first profile is measured.
_MIDDLE = 0.25
# Stiffness of a profile over the median weight of its samples. With 0.3 the edges of pixels, which
# are ramps one pixel wide, are rounded, and centres 0.002 to 0.03 px off; with 0.003 0.001 to 0.006.
_STIFFNESS = 0.003
# Cosine of the angle between the sides of a cell up to which it is rectangular.
_RECTANGULAR = 0.05


@dataclass(frozen=True)
class SquareMicroimages(Microimages):
    """Microimages whose light is a product of two edge profiles."""

    sides: Floats  # (2, 2) unit vectors across the two pairs of edges
    widths: Floats  # (2,) [px] of the cell between them
    edges: Floats  # (2, r) light over the distances from the middle lines

    @classmethod
    def of(cls, lenses: Microimages, lattice: Lattice) -> SquareMicroimages | None:
        """Microimages of a rectangular lattice with their mean profiles; None on other lattices."""
        across = np.linalg.inv(lattice.basis).T
        widths = 1 / np.hypot(*across.T)
        sides = across * widths[:, None]
        if abs(float(sides[0] @ sides[1])) > _RECTANGULAR:
            return None
        few = lenses.thin(_PIXELS)
        rings = int(widths.max() / 2 / _STEP) + 3
        known = {field.name: getattr(few, field.name) for field in fields(few)}
        # The slope of the light in a lens is measured where its edges are far.
        known["profile"] = np.ones_like(few.profile)
        known["ring_weight"] = np.ones(rings)
        found = cls(**known, sides=sides, widths=widths, edges=np.ones((2, rings)))
        edges = found._mean_edges()
        weight = np.full(rings, 1 / max(float(np.var(edges)), 1e-12))
        found = replace(found, edges=edges, ring_weight=weight)
        return found.learn_profile(found.sums())

    def distances(self) -> Floats:
        """(2, n, k, k) signed distances [px] of the pixels from the middle lines."""
        x, y = self.places()
        return np.stack([x * across + y * down for across, down in self.sides])

    def relative(self) -> Floats:
        """(n, k, k) light of the pixels over that of their lens."""
        x, y = self.places()
        slope = (self.slope + self.shade)[:, :, None, None]
        tilt = 1 + slope[:, 0] * x + slope[:, 1] * y
        return np.asarray(self.light / (self.gain[:, None, None] * tilt))

    def residuals(self) -> Floats:
        """(m,) differences of the pixels in the cells from the model."""
        far = self.distances()
        inside = (np.abs(far) <= self.widths[:, None, None, None] / 2).all(0)
        model = np.prod([self._light(k, far[k][inside])[0] for k in (0, 1)], axis=0)
        return np.asarray(self.relative()[inside] - model)

    def sums(self) -> Sums:
        """Normal equations about this model, and sums over the samples of both profiles."""
        far = self.distances()
        inside = (np.abs(far) <= self.widths[:, None, None, None] / 2).all(0)
        inside &= self.light < self.saturation
        lens = np.nonzero(inside)[0]
        far = far[:, inside]
        profiles = [self._light(k, far[k]) for k in (0, 1)]
        lights = np.array([light for light, _ in profiles])
        slopes = np.array([slope for _, slope in profiles])
        model = lights[0] * lights[1]
        residual = self.relative()[inside] - model
        ring = np.rint(np.abs(far) / _STEP).astype(np.int64)
        outer = ring.max(0)
        weight = self.ring_weight[outer]
        chi = residual**2 * weight / TUKEY_CUTOFF**2
        used = chi < 1
        weight = weight * np.clip(1 - chi, 0, None) ** 2
        push = -slopes * lights[::-1]
        columns = np.column_stack([(push.T @ self.sides), model])
        count = len(self.centres)
        normal = np.zeros((count, 3, 3))
        right = np.zeros((count, 3))
        for a in range(3):
            right[:, a] = np.bincount(lens, weight * columns[:, a] * residual, count)
            for b in range(a, 3):
                products = weight * columns[:, a] * columns[:, b]
                normal[:, a, b] = np.bincount(lens, products, count)
        size = self.edges.shape[1]
        band = np.zeros((2, size, 4))
        for k in (0, 1):
            other = lights[1 - k]
            places = self._places(far[k])
            band[k, :, 0] = places.add(weight * other**2, size)
            band[k, :, 1] = places.add(weight * other * residual, size)
            band[k, :, 2] = np.bincount(outer, used * residual**2, size)
            band[k, :, 3] = np.bincount(outer, used, size)
        return Sums(normal, right, band)

    def learn_profile(self, sums: Sums) -> SquareMicroimages:
        """The microimages with edge profiles and weights that fit the pixels better."""
        size = self.edges.shape[1]
        bend = np.diff(np.eye(size), 2, axis=0)
        edges = self.edges.copy()
        for profile, band in zip(edges, sums.band, strict=True):
            weight = band[:, 0]
            stiff = _STIFFNESS * float(np.median(weight[weight > 0])) * bend.T @ bend
            settled = np.diag(weight + 1e-9 * weight.max())
            # Both profiles take half of what they can explain together.
            force = band[:, 1] / 2 - stiff @ profile
            profile += np.linalg.solve(settled + stiff, force)
            profile *= 1 / profile[: size // 2].mean()
        variance = estimate_variance(*sums.band[0, :, 2:].T)
        return replace(self, edges=edges, ring_weight=1 / np.maximum(variance, 1e-9))

    def _places(self, far: Floats) -> ProfilePlaces:
        return ProfilePlaces.of(np.abs(far) / _STEP, self.edges.shape[1])

    def _light(self, axis: int, far: Floats) -> tuple[Floats, Floats]:
        """Light of one profile at signed distances, and its slope [1/px]."""
        places = self._places(far)
        slope = places.read(np.gradient(self.edges[axis], _STEP))
        return places.read(self.edges[axis]), slope * np.sign(far)

    def _mean_edges(self) -> Floats:
        """(2, r) mean light over the distances from the middle lines, near the other line."""
        far = np.abs(self.distances())
        light = self.relative()
        edges = np.ones_like(self.edges)
        rings = edges.shape[1]
        for k in (0, 1):
            near = (far[1 - k] < _MIDDLE * self.widths[1 - k]) & (far[k] <= self.widths[k] / 2)
            ring = np.rint(far[k][near] / _STEP).astype(np.int64)
            number = np.bincount(ring, minlength=rings)
            edges[k] = average_profile(np.bincount(ring, light[near], rings), number)
        return edges / edges[:, : rings // 2].mean(1, keepdims=True)
