"""The microlens lattice: centres of the microimages from an origin, two basis vectors and a
distortion.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..runtime.arrays import Array, Floats, Frozen, Integers
from ..runtime.errors import check_number, check_numbers
from .distortion import Distortion

# [squared length] nearer is equal: measured hexagons get the basis of exact ones.
_EQUAL = 5e-3
# Steps of a reduction at most. Each but the last two shortens a squared length to a third, so that
# vectors whose lengths differ by a factor of 1e14 are reduced.
_MOST_STEPS = 64
# Smallest relative change of a squared length that is none of rounding.
_ROUNDING = 1e-12
# [lenses] handled at once, so that hardly more memory is needed than for the result, and centres
# kept at most.
_CHUNK = 1 << 20
# Share of a side, and cosine, up to which a cell counts as square.
_TOLERANCE = 0.03

__all__ = [
    "Lattice",
    "describe_orientation",
    "irregularity",
    "nearest_regular_ratio",
    "reduce_basis",
    "shorten_bases",
]


def shorten_bases(pairs: ArrayLike) -> Floats:
    """(m, 2, 2) shortest bases of the lattices that `pairs` of vectors (m, 2, 2) span, the shorter
    vector first (Lagrange-Gauss reduction).

    A step that shortens a vector by no more than rounding is not taken, so that vectors at a tie do
    not alternate. Pairs that are parallel, zero or not finite span no lattice and are of no use.
    """
    bases = np.array(pairs, dtype=np.float64)
    for _ in range(_MOST_STEPS):
        squares = (bases * bases).sum(-1)
        bases = np.where((squares[:, :1] > squares[:, 1:])[..., None], bases[:, ::-1], bases)
        a, b = np.moveaxis(bases, 1, 0)
        square = np.maximum((a * a).sum(-1), np.finfo(float).tiny)
        with np.errstate(invalid="ignore"):
            shorter = b - np.rint((a * b).sum(-1) / square)[:, None] * a
        moves = (shorter * shorter).sum(-1) < (1 - _ROUNDING) * (b * b).sum(-1)
        if not moves.any():
            break
        bases = np.stack([a, np.where(moves[:, None], shorter, b)], axis=1)
    return bases


def nearest_regular_ratio(basis: Floats) -> complex:
    """`a2 / a1` of the square or hexagonal array that is next to a reduced basis (2, 2), as complex
    numbers `x + iy`.

    Examples
    --------
    >>> nearest_regular_ratio(np.array([[20.0, 0.0], [0.0, 21.0]]))
    1j
    """
    a1, a2 = basis @ [1, 1j]
    regular = (complex(0.5, 0.75**0.5), 1j)
    return min(regular, key=lambda ratio: abs(complex(a2 / a1) - ratio))


def irregularity(basis: Floats) -> float:
    """How far a reduced basis (2, 2) is from that of a square or hexagonal array, over its length.

    Examples
    --------
    >>> round(irregularity(np.array([[20.0, 0.0], [0.0, 21.0]])), 3)
    0.05
    """
    a1, a2 = basis @ [1, 1j]
    return abs(complex(a2 / a1) - nearest_regular_ratio(basis))


def reduce_basis(basis: ArrayLike) -> Floats:
    """(2, 2) shortest basis of the lattice that two vectors [px] span (Lagrange-Gauss reduction),
    in a canonical form.

    `a1` points within 45 degrees of +x where a shortest vector does, `a2` follows it clockwise on
    the screen (y down) at 60 to 90 degrees.
    """
    a, b = np.array(basis, dtype=np.float64)
    if not np.isfinite([a, b]).all() or abs(a[0] * b[1] - a[1] * b[0]) <= 1e-12 * (a @ a + b @ b):
        raise ValueError(
            f"basis must be two independent finite vectors, got {np.asarray(basis).tolist()}"
        )
    a, b = shorten_bases([[a, b]])[0]
    candidates = [v for v in (a, b, a - b, a + b) if v @ v <= (b @ b) * (1 + _EQUAL)]
    candidates += [-v for v in candidates]
    least = b @ b
    pairs = [
        (one, two)
        for one in candidates
        for two in candidates
        if one[0] * two[1] - one[1] * two[0] > 1e-9 * least and one @ two >= -1e-6 * least
    ]

    def rank(pair: tuple[Floats, Floats]) -> tuple[float, ...]:
        # Lengths decide before directions, and directions only where they differ by more than
        # rounding.
        one, two = pair
        size = (one @ one + two @ two) / least
        return (
            -round(size / _EQUAL),
            round(float(one[0] / np.hypot(*one)), 6),
            float(one[1]),
            float(one @ two),
        )

    return np.array(max(pairs, key=rank))


@dataclass(frozen=True, eq=False, repr=False)
class Lattice(Frozen):
    """Centres `c(i, j) = origin + i*a1 + j*a2`, plus an optional distortion, of all microimages on
    one flat.

    Parameters
    ----------
    origin : (2,) float64 [px]
        Centre of microimage (0, 0), order `x, y`, pixel centres at integers.
    basis : (2, 2) float64 [px]
        Rows `a1, a2`.
    image_size : (int, int) [px]
        Width and height of the flat.
    radius : float [px]
        Usable microimage radius `R`.
    distortion : Distortion or None
        Displacement of the centres from the straight lattice; None where there is none.

    Examples
    --------
    >>> lattice = Lattice((5, 5), [[10, 0], [0, 10]], (40, 30), 4.5)
    >>> len(lattice), lattice.pitch
    (12, 10.0)
    >>> lattice.points([[3, 2]])
    array([[35., 25.]])
    """

    origin: Floats
    basis: Floats
    image_size: tuple[int, int]
    radius: float
    distortion: Distortion | None = None

    def __post_init__(self) -> None:
        origin = check_numbers(self.origin, "origin")
        basis = check_numbers(self.basis, "basis")
        if origin.shape != (2,) or not np.abs(origin).max() < 1e9:
            raise ValueError(f"origin must be two finite numbers on a flat, got {self.origin!r}")
        if (
            basis.shape != (2, 2)
            or not np.isfinite(basis).all()
            or abs(np.linalg.det(basis)) < 1e-6
        ):
            raise ValueError(f"basis must be two independent finite vectors, got {self.basis!r}")
        size = check_numbers(self.image_size, "image_size")
        if size.shape != (2,) or not (size == np.rint(size)).all() or size.min() < 1:
            raise ValueError(
                "image_size must be a whole number of px in width and height, "
                f"got {self.image_size!r}"
            )
        width, height = map(int, size)
        across = np.abs(np.linalg.inv(basis)).max() * (width + height)
        if across > 1e7 or width * height > min(1 << 31, (1 << 27) * abs(np.linalg.det(basis))):
            raise ValueError(
                f"no camera has {width} x {height} px full of lenses a basis of {self.basis!r} px "
                "apart"
            )
        radius = check_number(self.radius, "radius")
        if not 0 < radius < np.inf:
            raise ValueError(f"radius must be a positive number of px, got {self.radius!r}")
        self._set(origin=origin, basis=basis, image_size=(width, height), radius=radius)

    def __len__(self) -> int:
        return len(self._indices)

    def __repr__(self) -> str:
        width, height = self.image_size
        return (
            f"Lattice({len(self)} microimages, {self.pitch:.4g} px apart, on {width} x {height} px)"
        )

    @cached_property
    def steps(self) -> Integers:
        """(k, 2) index steps to the nearest neighbours, opposite steps `k/2` apart: k = 6
        (hexagonal) or 4.
        """
        a1, a2 = self.basis
        half = [(1, 0), (0, 1)]
        typical = np.sqrt(np.hypot(*a1) * np.hypot(*a2))
        diagonal = min((a1 + a2, (1, 1)), (a1 - a2, (1, -1)), key=lambda d: np.hypot(*d[0]))
        # 1 in hexagons, 1.41 in squares.
        if np.hypot(*diagonal[0]) <= 1.2 * typical:
            half.append(diagonal[1])
        return np.array(half + [(-i, -j) for i, j in half], dtype=np.int64)

    @cached_property
    def pitch(self) -> float:
        """D: mean distance between neighbouring microimage centres [px]."""
        return float(np.linalg.norm(self.steps @ self.basis, axis=1).mean())

    @property
    def reach(self) -> float:
        """Half the diagonal of the flat [px]."""
        return float(np.hypot(*self.image_size) / 2)

    @property
    def middle(self) -> Integers:
        """(2,) index of the lens nearest to the middle of the flat."""
        middle = (np.array(self.image_size) - 1) / 2
        return np.rint(self.to_index(middle[None])[0]).astype(np.int64)

    @cached_property
    def _indices(self) -> Integers:
        width, height = self.image_size
        # Edges of the flat are curved lines on a distorted lattice.
        along = np.linspace(-0.5, 0.5, 33)
        ends = np.array([-0.5, 0.5])
        edges = np.vstack(
            [
                np.stack(np.meshgrid(*pair), -1).reshape(-1, 2)
                for pair in ((along, ends), (ends, along))
            ]
        )
        bounds = self.to_index((edges + 0.5) * [width, height] - 0.5)
        low = np.floor(bounds.min(0)).astype(int)
        high = np.ceil(bounds.max(0)).astype(int)
        columns, rows = (np.arange(low[axis], high[axis] + 1) for axis in (0, 1))
        across, down = np.abs(self.basis[0])
        steep = down > 0.25 * across
        found = []
        order = []
        for few in np.array_split(rows, -(-len(rows) * len(columns) // _CHUNK)):
            ij = np.stack(np.meshgrid(columns, few), -1).reshape(-1, 2)
            x, y = self.points(ij).T
            inside = np.flatnonzero(
                (x >= -0.5) & (x < width - 0.5) & (y >= -0.5) & (y < height - 0.5)
            )
            found.append(ij.take(inside, 0))
            if steep:
                band = (y[inside] * (2 / self.pitch)).astype(np.int64)
                order.append(band * width + x[inside].astype(np.int64))
        indices = np.concatenate(found)
        return indices[np.argsort(np.concatenate(order))] if steep else indices

    def indices(self) -> Integers:
        """(n, 2) lattice indices `i, j` of all microimages whose centre lies on the flat.

        In rows of `j`, or, where those run down the flat, in rows of pixels half a pitch high, from
        top to bottom: loops over the pixels of lenses in memory order are up to twice as fast.
        """
        return self._indices.copy()

    def centres(self) -> Floats:
        """(n, 2) float64 centres `x, y` [px], in the order of `indices()`."""
        if len(self) <= _CHUNK:
            return self._centres.copy()
        centres = np.empty((len(self), 2))
        for start in range(0, len(self), _CHUNK):
            centres[start : start + _CHUNK] = self.points(self._indices[start : start + _CHUNK])
        return centres

    @cached_property
    def _centres(self) -> Floats:
        return self.points(self._indices)

    def select_whole(self, margin: float) -> tuple[Integers, Floats]:
        """Indices (n, 2) and centres (n, 2) of lenses at least `margin` px inside the flat."""
        centres = self.centres()
        width, height = self.image_size
        x, y = centres.T
        # Comparing two columns, and `take`, are several times as fast as comparing and indexing
        # rows of two.
        keep = np.flatnonzero(
            (x >= margin) & (x <= width - 1 - margin) & (y >= margin) & (y <= height - 1 - margin)
        )
        return self._indices.take(keep, 0), centres.take(keep, 0)

    def select_in_rectangle(self, low: Floats, high: Floats) -> Integers:
        """(n, 2) indices of the lenses with centres in a rectangle of the flat."""
        # A grid of positions, as a distorted lattice has no straight borders.
        share = np.linspace(0, 1, 5)
        x, y = np.meshgrid(*(low[axis] + share * (high[axis] - low[axis]) for axis in (0, 1)))
        bounds = self.to_index(np.column_stack([x.ravel(), y.ravel()]))
        least = np.floor(bounds.min(0)).astype(np.int64) - 1
        most = np.ceil(bounds.max(0)).astype(np.int64) + 1
        i, j = np.meshgrid(np.arange(least[0], most[0] + 1), np.arange(least[1], most[1] + 1))
        index = np.column_stack([i.ravel(), j.ravel()])
        centres = self.points(index)
        return index[((centres >= low) & (centres <= high)).all(1)]

    def with_radius(self, radius: float) -> Lattice:
        """The same lenses with another usable radius [px]."""
        other = replace(self, radius=radius)
        for name in ("_indices", "_centres"):
            if name in self.__dict__:
                other.__dict__[name] = self.__dict__[name]
        return other

    def downscaled(self, factor: int) -> Lattice:
        """The lattice of the flat after averaging blocks of `factor` x `factor` pixels."""
        return self if factor == 1 else self.derived(_downscaled, factor)

    def scaled(self, scale: float, image_size: tuple[int, int]) -> Lattice:
        """The lattice in pixels smaller by `scale`, on a flat of `image_size` of them."""
        distortion = self.distortion and self.distortion.scaled(scale)
        origin = (self.origin + 0.5) * scale - 0.5
        return Lattice(origin, self.basis * scale, image_size, self.radius * scale, distortion)

    def points(self, index: ArrayLike) -> Floats:
        """(n, 2) positions `x, y` [px] of lattice indices (n, 2), which may be fractions and beyond
        the flat.
        """
        index = np.asarray(index)
        # Column by column: three times as fast as a product with a 2 x 2 matrix.
        straight = np.empty(index.shape)
        for axis in range(2):
            column = index[..., 0] * self.basis[0, axis]
            column += index[..., 1] * self.basis[1, axis]
            np.add(column, self.origin[axis], out=straight[..., axis])
        return straight if self.distortion is None else self.distortion.apply(straight)

    def field_place(self, points: Floats) -> Floats:
        """(n, 2) flat positions [px] from the middle of the flat, in half diagonals."""
        return np.asarray((points - (np.array(self.image_size) - 1) / 2) / self.reach)

    def derivatives(self, index: Array, orders: Collection[str]) -> tuple[list[str], Floats]:
        """Names of origin, basis and the parameters `orders` of the distortion; derivatives (n, 2,
        p) of centres.
        """
        factors = np.column_stack([np.ones(len(index)), index])
        columns = [factors[:, [k]] * np.eye(2)[axis] for k in range(3) for axis in range(2)]
        names = ["origin", "origin", "a1", "a1", "a2", "a2"]
        if self.distortion is not None:
            found = self.distortion.derivatives(self.origin + index @ self.basis)
            names += [name for name, _ in found if name in orders]
            columns += [values for name, values in found if name in orders]
        return names, np.stack(columns, axis=2)

    def moved(self, change: Floats, names: Sequence[str] = ()) -> Lattice:
        """The lattice after a change (p,) of origin, basis and distortion, as in `derivatives`."""
        straight = change[:6].reshape(3, 2)
        bend = self.distortion and self.distortion.updated(names[6:], change[6:])
        origin = self.origin + straight[0]
        return replace(self, origin=origin, basis=self.basis + straight[1:], distortion=bend)

    def to_index(self, points: ArrayLike) -> Floats:
        """(n, 2) real-valued lattice indices of flat positions `points` (n, 2) [px]."""
        straight = np.asarray(points, dtype=np.float64)
        if self.distortion is not None:
            straight = self.distortion.remove(straight)
        return (straight - self.origin) @ np.linalg.inv(self.basis)


def _downscaled(lattice: Lattice, factor: int) -> Lattice:
    width, height = lattice.image_size
    small = lattice.scaled(1 / factor, (max(1, width // factor), max(1, height // factor)))
    # Rounding must not add or remove lenses at the border.
    small.__dict__["_indices"] = lattice._indices
    return small


def describe_orientation(lattice: Lattice) -> tuple[str, str, float]:
    """Shape, direction of the rows of nearest neighbours, and rotation from that direction
    [degrees].
    """
    a1, a2 = lattice.basis
    lengths = np.hypot(*a1), np.hypot(*a2)
    hexagonal = len(lattice.steps) == 6
    if hexagonal:
        shape = "hexagonal"
    elif abs(a1 @ a2) > _TOLERANCE * lengths[0] * lengths[1]:
        shape = "oblique"
    else:
        shape = "square" if min(lengths) > (1 - _TOLERANCE) * max(lengths) else "rectangular"
    period = 60.0 if hexagonal else 90.0
    turned = (float(np.degrees(np.arctan2(a1[1], a1[0]))) + period / 2) % period - period / 2
    if hexagonal and abs(turned) > 15:
        return shape, "vertical", turned - np.copysign(30.0, turned)
    return shape, "horizontal" if hexagonal else "both ways", turned
