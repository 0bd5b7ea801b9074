"""Size and sharpness of microimages over the field, whether they leave gaps or overlap.

A microimage is the exit pupil of the main lens, blurred over the disc by which its microlens is out
of focus there. The mean microimage of each of some tiles of the flat, at a finer grid than pixels,
is compared with a sum of such discs over the nearest lenses, so that overlap can be measured as
well as gaps. How the tiles scatter about a smooth field tells the errors.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from ..camera.calibration import Calibration
from ..gain.gain_map import nearest_half
from ..images.mosaic import equalise_mosaic
from ..images.preprocessing import luminance
from ..lattice.cell import Cell
from ..lattice.robust_fit import MAD_TO_SIGMA
from ..microimage.average import LensPixels
from ..microimage.edge import blurred_edge
from ..microimage.lit import STRAY, UNLIT, is_lit
from ..runtime.arrays import evenly, white_of
from ..runtime.light.tone import decode_srgb

__all__ = ["LIGHT_FAULT", "Field", "MicroimageField", "measure_microimages"]

Array = NDArray[np.float64]
# Errors of the model, which the scatter of tiles does not show (`python -m benchmarks.assess`;
# white images of others). [px] of radii; [1] more of them per px of blur, which need not be a disc;
# [px] more for apertures with straight sides.
_RADIUS_FAULT = 0.02
_SHAPE_FAULT = 0.02
_SIDES_FAULT = 0.15
# Of the diameter of the blur: [1] its share; [px] of a disc of 1 px, as pixels hide small ones.
_BLUR_SHARE = 0.04
_BLUR_FAULT = 0.25
LIGHT_FAULT = 0.002  # of the logarithm of the light
# Start of the fit: radius over half the distance to the neighbours; blur [px], light, shading and
# stray light.
_START_RADIUS = 0.93
_START = (1.5, 1.0, 0.0, 0.02)
# Least and largest radius [pitch]; blur from [px] to [pitch], light, shading, stray light.
_RADII = (0.1, 0.8)
_LOW = (0.05, 0.3, -1.0, -0.1)
_MOST_BLUR = 0.5
_HIGH = (1.7, 1.0, 0.9)
# Light beyond which misfits count less.
_MISFIT = 0.03
# Misfits over those of round discs below which sides are straight, and beyond which there are none.
_STRAIGHT = 0.8
_MOST_MISFIT = 0.15
# [px] Side of the squares, of white images and of scenes, and how many of them are compared. With
# sides of 1 px, discs of 2.2 px on white images were 0.05 px too wide, and those of 0.2 px 0.4 px.
# Smaller squares of scenes hold too few pixels to average their content.
_SIDE = 0.5
_SIDE_OF_SCENES = 1.0
_SQUARES = 1000
# Lenses of a tile for each type; tiles each way of arrays of several types; pixels of a tile.
_LENSES_OF_TILE = 30
_MOST_TILES = 4
_PIXELS_OF_TILE = 6e4
# [cell] Pixels up to a little beyond the border are averaged.
_BORDER = 0.52


class Field(NamedTuple):
    """A quantity in the middle of the flat, and its slope per half diagonal, with errors."""

    value: float
    error: float
    slope: Array  # (2,)
    slope_error: float
    bend: float  # difference of the corners from the middle, without the slope

    @classmethod
    def fit(cls, place: Array, values: Array, fault: float, common: float = 0.0) -> Field:
        """Smooth field through values (n,) of tiles, with an error of the model, and one that all
        of them share.
        """
        x, y = place.T
        # Fewer tiles tell fewer terms.
        table = np.column_stack([np.ones(len(x)), x, y, x * x + y * y])[
            :, : 4 if len(x) >= 8 else 1
        ]
        free = len(x) - table.shape[1]
        weight = np.ones(len(x))
        for _ in range(5):
            inverse = np.linalg.pinv(table.T @ (weight[:, None] * table))
            factors = inverse @ table.T @ (weight * values)
            miss = np.abs(values - table @ factors)
            weight = np.minimum(
                1, (3 * MAD_TO_SIGMA * float(np.median(miss)) + 1e-9) / np.maximum(miss, 1e-12)
            )
        variance = (
            np.diag(inverse) * float((weight * miss**2).sum() / free)
            if free
            else np.full(len(inverse), np.inf)
        )
        error = float(np.sqrt(variance[0] + fault**2 + common**2))
        if len(factors) == 1:
            return cls(float(factors[0]), error, np.full(2, np.nan), float("inf"), float("nan"))
        slope_error = float(np.sqrt(variance[1:3].mean() + fault**2))
        return cls(float(factors[0]), error, factors[1:3], slope_error, float(factors[3]))

    def mixed(self, other: Field) -> Field:
        """The mean of what two assumptions give; half their difference is part of the errors."""
        error = float(np.hypot(self.error, (self.value - other.value) / 2))
        slope_error = float(np.hypot(self.slope_error, np.hypot(*(self.slope - other.slope)) / 2))
        value = self.value + other.value
        slope = self.slope + other.slope
        bend = self.bend + other.bend
        return Field(value / 2, error, slope / 2, slope_error, bend / 2)


@dataclass(frozen=True)
class MicroimageField:
    """What the microimages of the tiles of a white image look like."""

    place: Array  # (n, 2) of tiles, from the middle of the flat in half diagonals
    radii: Array  # (n, types) [px]
    radius: Field  # [px], mean of the types
    blur: tuple[Field, ...]  # [px], of each type
    level: Field  # logarithm of the light in the middles of microimages
    profile: tuple[
        Array, Array, Array
    ]  # distance [px], measured and modelled light in the middle of the flat


class _Tile(NamedTuple):
    """The mean microimage of each type in a tile of the flat, in small squares of the cell."""

    place: Array  # (2,) in half diagonals from the middle of the flat
    level: float  # light in the middles of microimages
    kind: NDArray[np.int64]  # (m,) type
    side: float  # [px] of the squares
    offset: Array  # (m, 2) [px] mean place of the pixels of a square
    light: Array  # (m,) over that in the middle of the microimages
    weight: Array  # (m,)


# The equations are too small for more threads to pay off: they would wait for each other.
@threadpool_limits.wrap(limits=1, user_api="blas")
def measure_microimages(
    flat: NDArray[Any], camera: Calibration, most: int = 5, widest: float = np.inf
) -> MicroimageField | None:
    """Size and sharpness of the microimages of a white image, or None without visible discs.

    At most `most` tiles each way are measured, and none if the blur in the middle of the flat is
    wider than `widest` [px].
    Values of 8 bits of which nobody knows whether they are linear are taken as explains the
    microimages better, or as both where that does not tell.
    """
    unknown = camera.encoded is None and flat.dtype == np.uint8
    model = _Model.of(camera)
    starts = []
    for encoded in (True, False) if unknown else (bool(camera.encoded),):
        tiles = _average_tiles(flat, camera, encoded, model.count, most)
        middle = next(tiles, None)
        if middle is not None:
            usual = model.start(_START_RADIUS * nearest_half(camera.lattice))
            start = (model, *model.fit(middle, usual), chain([middle], tiles))
            if start[2] > _MISFIT:
                sides = replace(model, straight=True)
                straight = (sides, *sides.fit(middle, usual), start[3])
                if straight[2] < _STRAIGHT * start[2]:
                    start = straight
            starts.append(start)
    least = min((miss for _, _, miss, _ in starts), default=1.0)
    # Two of 11 simulated cameras have less than 1.5; where a disc cuts, both may explain what the
    # other does.
    starts = [start for start in starts if len(model.cut) or start[2] <= 2 * least]
    t = model.count
    if least > _MOST_MISFIT or any(
        (start[t : 2 * t] > np.minimum(start[:t], widest / 2)).any() for _, start, _, _ in starts
    ):
        # No discs, or spots that are all blur.
        return None
    first, *others = (_fit_tiles(chosen, tiles, start) for chosen, start, _, tiles in starts)
    for other in others:
        blur = tuple(one.mixed(two) for one, two in zip(first.blur, other.blur, strict=True))
        first = replace(
            first,
            radius=first.radius.mixed(other.radius),
            level=first.level.mixed(other.level),
            blur=blur,
        )
    return first


@dataclass(frozen=True)
class _Model:
    """Blurred discs of the nearest lenses: radii, radii of blur and light of each type; shading,
    stray light.

    With `straight`, they have straight sides along the cell instead.
    """

    steps: Array  # (k, 2) [px] to the lens itself and its neighbours
    kinds: NDArray[np.int64]  # (types, k) types of these lenses
    normals: Array  # (k, 2) of unit length, to half of the neighbours
    cut: Array  # (5,) of the gain map, or none
    pitch: float
    straight: bool = False

    @classmethod
    def of(cls, camera: Calibration) -> _Model:
        lattice = camera.lattice
        types = camera.lens_types
        around = np.vstack([np.zeros((1, 2), np.int64), lattice.steps])
        kinds = np.zeros((1, len(around)), np.int64)
        if types is not None:
            firsts = [np.argwhere(types.cell == kind)[0] for kind in range(types.count)]
            kinds = np.array([types.of(first + around) for first in firsts], np.int64)
        half = (lattice.steps @ lattice.basis)[: len(lattice.steps) // 2]
        cut = np.zeros(0) if camera.gain_map is None else camera.gain_map.cut
        return cls(
            around @ lattice.basis, kinds, half / np.hypot(*half.T)[:, None], cut, lattice.pitch
        )

    @property
    def count(self) -> int:
        return len(self.kinds)

    def start(self, *values: float) -> Array:
        """Parameters from a radius and, unless they are the usual ones, all other values."""
        return np.repeat((*values, *_START[len(values) - 1 :]), [self.count] * 3 + [1, 1])

    def light(self, tile: _Tile, p: Array) -> tuple[Array, Array]:
        """Light (m,) at the squares of a tile, and its slopes (m, k) by the parameters."""
        t = self.count
        total = np.full(len(tile.kind), p[-1])
        slopes = np.zeros((len(tile.kind), len(p)))
        slopes[:, -1] = 1
        width = float(np.hypot(1, tile.side))
        # Corners between straight sides are farther away.
        reach = (1 + self.straight) * float(p[:t].max() + p[t : 2 * t].max() + width)
        for number, step in enumerate(self.steps):
            rows = np.flatnonzero(np.hypot(*(tile.offset - step).T) < reach)
            away = tile.offset[rows] - step
            far = np.hypot(*away.T)
            kind = self.kinds[tile.kind[rows], number]
            radius, blur, level = p[: 3 * t].reshape(3, t)[:, kind]
            if self.straight:
                seen = _blurred_sides(np.abs(away @ self.normals.T), radius, blur, width)
            else:
                seen = _blurred_disc(far, radius, blur, width)
            if len(self.cut):
                inside = self.cut[3] - np.hypot(*(away - self.cut[:2] - self.cut[2] * tile.place).T)
                seen *= blurred_edge(inside, 2 * self.cut[4], width).light
            square = (far / radius) ** 2
            shade = 1 + p[-2] * square
            total[rows] += level * shade * seen[0]
            of_shade = -2 * p[-2] * square / radius
            slopes[rows, kind] += level * (shade * seen[1] + of_shade * seen[0])
            slopes[rows, t + kind] += level * shade * seen[2]
            slopes[rows, 2 * t + kind] += shade * seen[0]
            slopes[rows, -2] += level * square * seen[0]
        return total, slopes

    def fit(self, tile: _Tile, start: Array) -> tuple[Array, float]:
        """Parameters that explain mean microimages best, and the weighted RMS of what is left."""
        from scipy.optimize import least_squares

        root = np.sqrt(tile.weight / tile.weight.mean())
        low = self.start(_RADII[0] * self.pitch, *_LOW)
        high = self.start(_RADII[1] * self.pitch, _MOST_BLUR * self.pitch, *_HIGH)

        # The solver asks for the slopes where it has just asked for the misfits.
        @lru_cache(1)
        def light(parameters: bytes) -> tuple[Array, Array]:
            return self.light(tile, np.frombuffer(parameters))

        def miss(p: Array) -> Array:
            return root * (light(p.tobytes())[0] - tile.light)

        def slopes(p: Array) -> Array:
            return root[:, None] * light(p.tobytes())[1]

        found = least_squares(
            miss,
            np.clip(start, low, high),
            slopes,
            bounds=(low, high),
            loss="soft_l1",
            f_scale=_MISFIT,
            ftol=1e-4,
            xtol=1e-4,
            max_nfev=25,
        )
        return found.x, float(np.sqrt((found.fun**2).mean()))


def _blurred_disc(far: Array, radius: Array, blur: Array, width: float) -> Array:
    """Light of discs of `radius` at distances `far` from their middles, and its slopes (3, m).

    The slopes are those by the radii and by the radii of the blur.
    """
    seen = blurred_edge(radius - far, blur, width, 1 / radius)
    return np.array([seen.light, seen.by_depth - seen.by_curvature / radius**2, seen.by_blur])


def _blurred_sides(far: Array, radius: Array, blur: Array, width: float) -> Array:
    """Light between pairs of straight edges, and its slopes as of a disc (3, m).

    `far` (m, n) are the distances along the normals of `n` pairs; their light is multiplied.
    """
    out = np.zeros((3, len(far)))
    out[0] = 1
    for distance in far.T:
        edge = np.array(blurred_edge(radius - distance, blur, width)[:3])
        out = out * edge[0] + out[0] * edge * [[0], [1], [1]]
    return out


def _average_tiles(
    flat: NDArray[Any], camera: Calibration, encoded: bool, count: int, most: int
) -> Iterator[_Tile]:
    """Mean microimages of the tiles of the flat, that of the middle first."""
    lattice = camera.lattice
    types = camera.lens_types
    cell = Cell.of(lattice)
    indices, centres = lattice.select_whole(cell.circumradius + 2)
    kinds = (
        np.zeros(len(indices), np.int64) if types is None else types.of(indices).astype(np.int64)
    )
    if count > 1:
        most = min(most, _MOST_TILES)
    number = int(np.clip(np.sqrt(len(indices) / (_LENSES_OF_TILE * count)), 1, most))
    which = (centres / lattice.image_size * number).astype(int)
    parts = sorted(
        product(range(number), repeat=2), key=lambda at: np.hypot(*(2 * np.array(at) - number + 1))
    )
    for at in parts:
        own = np.flatnonzero((which == at).all(1))
        own = own[evenly(len(own), _PIXELS_OF_TILE / abs(np.linalg.det(lattice.basis)))]
        if len(own) >= 4 * count:
            tile = _average(flat, camera, cell, encoded, centres[own], kinds[own])
            if tile is not None and len(np.unique(tile.kind)) == count:
                yield tile


def _average(
    flat: NDArray[Any],
    camera: Calibration,
    cell: Cell,
    encoded: bool,
    centres: Array,
    kinds: NDArray[np.int64],
) -> _Tile | None:
    reach = int(np.ceil(cell.circumradius)) + 1
    # A mosaic begins at even pixels.
    low = np.maximum(np.floor(centres.min(0)).astype(int) - reach - 1, 0) // 2 * 2
    high = np.ceil(centres.max(0)).astype(int) + reach + 2
    part = flat[low[1] : high[1], low[0] : high[0]]
    light = equalise_mosaic(part) if camera.mosaic and part.ndim == 2 else luminance(part)
    pixels = LensPixels.of(light, centres - low, cell, border=_BORDER)
    if encoded:
        value = decode_srgb(pixels.value / (camera.white_level or white_of(flat)))
        pixels = pixels._replace(value=value)
    middle = pixels.distance() < 0.5 * cell.inradius
    core = np.bincount(pixels.lens, pixels.value * middle) / np.bincount(pixels.lens, middle)
    typical = float(np.median(core))
    # Neither dead lenses nor those behind dust.
    lit = is_lit(core, STRAY)
    if typical <= 0 or lit.sum() < 4:
        return None
    lens, x, y, value = pixels.select(lit[pixels.lens])
    side = _SIDE if camera.source == "white" else _SIDE_OF_SCENES
    across = int(2 * reach / side) + 3
    column, row = (np.floor((away + reach) / side).astype(np.int64) + 1 for away in (x, y))
    filled, key, number = np.unique(
        (kinds[lens] * across + row) * across + column, return_inverse=True, return_counts=True
    )
    mean, *places = (np.bincount(key, values) / number for values in (value / core[lens], x, y))
    place = camera.lattice.field_place(centres.mean(0)[None])[0]
    some = evenly(len(filled), _SQUARES)
    return _Tile(
        place,
        typical,
        filled[some] // across**2,
        side,
        np.column_stack(places)[some],
        mean[some],
        number[some].astype(float),
    )


def _fit_tiles(model: _Model, found: Iterable[_Tile], start: Array) -> MicroimageField:
    tiles = list(found)
    lit = is_lit(np.array([tile.level for tile in tiles]), UNLIT)
    # The start is that of the first tile.
    tiles = [tile for number, tile in enumerate(tiles) if number == 0 or lit[number]]
    table = np.array([start, *(model.fit(tile, start)[0] for tile in tiles[1:])])
    place = np.array([tile.place for tile in tiles])
    t = model.count
    middle = tiles[0]
    radii = table[:, :t]
    blurs = 2 * table[:, t : 2 * t]
    faults = [
        float(np.hypot(_BLUR_SHARE * d, _BLUR_FAULT / max(d, 0.5)))
        for d in np.median(blurs, axis=0)
    ]
    own = middle.kind == 0
    of_shape = np.hypot(_SHAPE_FAULT * np.median(blurs), _SIDES_FAULT * model.straight)
    return MicroimageField(
        place,
        radii,
        Field.fit(place, radii.mean(1), _RADIUS_FAULT, float(of_shape)),
        tuple(
            Field.fit(place, values, fault) for values, fault in zip(blurs.T, faults, strict=True)
        ),
        Field.fit(place, np.log([tile.level for tile in tiles]), LIGHT_FAULT),
        (np.hypot(*middle.offset[own].T), middle.light[own], model.light(middle, start)[0][own]),
    )
