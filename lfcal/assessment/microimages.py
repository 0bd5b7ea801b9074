"""Size and sharpness of microimages over the field, whether they leave gaps or overlap.

A microimage is the exit pupil of the main lens, blurred over the disc by which its microlens is out of focus there. The
mean microimage of each of some tiles of the flat, at a finer grid than pixels, is compared with a sum of such discs
over the nearest lenses, so that overlap can be measured as well as gaps. How the tiles scatter about a smooth field
tells the errors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..gain.gain_map import field_place, nearest_half
from ..images.mosaic import equalise_mosaic
from ..images.preprocessing import luminance
from ..lattice.cell import Cell
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import select_whole_lenses

__all__ = ["Field", "MicroimageField", "decode_srgb", "fit_field", "measure_microimages"]

Array = NDArray[np.float64]
_ACROSS_PIXEL = ((-(0.15**0.5), 5 / 18), (0.0, 8 / 18), (0.15**0.5, 5 / 18))
# Errors of the model, which the scatter of tiles does not show (`python -m benchmarks.assess`; white images of others).
# [px] of radii; [1] more of them per px of blur, which need not be a disc; [px] more for apertures with straight sides.
_RADIUS_FAULT = 0.02
_SHAPE_FAULT = 0.02
_SIDES_FAULT = 0.15
# Of the diameter of the blur: [1] its share; [px] of a disc of 1 px, as pixels hide small ones.
_BLUR_SHARE = 0.04
_BLUR_FAULT = 0.25
_LIGHT_FAULT = 0.002  # of the logarithm of the light


class Field(NamedTuple):
    """A quantity in the middle of the flat and its slope per half diagonal to the right and down, with errors."""

    value: float
    error: float
    slope: Array  # (2,)
    slope_error: float
    bend: float  # difference of the corners from the middle, without the slope
    bend_error: float

    def mixed(self, other: Field) -> Field:
        """The mean of what two assumptions give; their difference is part of the errors."""

        def both(one: float, two: float, error: float) -> tuple[float, float]:
            return (one + two) / 2, float(np.hypot(error, (one - two) / 2))

        value, error = both(self.value, other.value, self.error)
        bend, bend_error = both(self.bend, other.bend, self.bend_error)
        change = float(np.hypot(*(self.slope - other.slope))) / 2
        slope_error = float(np.hypot(self.slope_error, change))
        return Field(value, error, (self.slope + other.slope) / 2, slope_error, bend, bend_error)


@dataclass(frozen=True)
class MicroimageField:
    """What the microimages of the tiles of a white image look like."""

    place: Array  # (n, 2) of tiles, from the middle of the flat in half diagonals
    radii: Array  # (n, types) [px]
    radius: Field  # [px], mean of the types
    blur: tuple[Field, ...]  # [px], of each type
    level: Field  # logarithm of the light in the middles of microimages
    sides: int  # 0 of round microimages, else how many straight ones
    profile: tuple[Array, Array, Array]  # distance [px], measured and modelled light in the middle of the flat


def measure_microimages(flat: NDArray[Any], camera: Calibration) -> MicroimageField | None:
    """Size and sharpness of the microimages of a white image; None where they cannot be measured.

    Values of 8 bits of which nobody knows whether they are linear are taken as explains the microimages better, or as
    both where that does not tell.
    """
    curves = [bool(camera.encoded)]
    if camera.encoded is None and flat.dtype == np.uint8:
        curves = [True, False]
    model, starts = _make_model(camera), []
    for encoded in curves:
        tiles = _average_tiles(flat, camera, encoded, model.count)
        if tiles:
            starts.append((*_fit_middle(model, tiles[0], camera.lattice), tiles))
    if not starts:
        return None
    least = min(left for _, _, left, _ in starts)
    # Two of 11 simulated cameras have less than 1.5; where a disc cuts, both may explain what the other does.
    most = float("inf") if len(model.cut) else 2 * least
    t, starts = model.count, [start for start in starts if start[2] <= most]
    if least > 0.15 or any((start[t : 2 * t] > start[:t]).any() for _, start, *_ in starts):
        # No discs, or spots that are all blur.
        return None
    fields = [_fit_tiles(chosen, tiles, start) for chosen, start, _, tiles in starts]
    first, last = fields[0], fields[-1]
    return replace(
        first, radius=first.radius.mixed(last.radius), level=first.level.mixed(last.level),
        blur=tuple(one.mixed(two) for one, two in zip(first.blur, last.blur, strict=True)),
    )  # fmt: skip


class _Mean(NamedTuple):
    """Mean microimage of each type in a tile: pixels in small squares of the cell."""

    kind: NDArray[np.int64]  # (m,) type
    side: float  # [px] of the squares
    offset: Array  # (m, 2) [px] mean place of the pixels of a square
    light: Array  # (m,) over that in the middle of the microimages
    weight: Array  # (m,)


class _Tile(NamedTuple):
    place: Array  # (2,) in half diagonals from the middle of the flat
    mean: _Mean
    light: float  # of the middles of microimages


@dataclass(frozen=True)
class _Model:
    """Blurred discs of the nearest lenses; `sides` 0: round ones, else with straight sides along the cell."""

    steps: Array  # (k, 2) [px] to the lens itself and its neighbours
    kinds: NDArray[np.int64]  # (types, k) types of these lenses
    normals: Array  # (k, 2) of unit length, to half of the neighbours
    cut: Array  # (5,) of the gain map, or none
    pitch: float
    sides: int = 0

    @property
    def count(self) -> int:
        return len(self.kinds)

    def shift(self, place: Array) -> Array:
        """Displacement (2,) [px] of the cutting disc at a place in the field."""
        return np.asarray(self.cut[:2] + self.cut[2] * place) if len(self.cut) else np.zeros(2)

    def start(self, radius: float) -> Array:
        """Radii, radii of blur and light of each type; shading at the rim, stray light."""
        return np.repeat([radius, 1.5, 1.0, 0.0, 0.02], [self.count] * 3 + [1, 1])

    def light(self, mean: _Mean, p: Array, shift: Array) -> Array:
        """(m,) light at the squares of mean microimages, in a tile where the cut is displaced by `shift` (2,)."""
        t, total = self.count, np.full(len(mean.kind), p[-1])
        # Of the blur by the squares, places of mean pixels leave two thirds.
        width = float(np.sqrt(1 + 0.65 * mean.side**2))
        for number, step in enumerate(self.steps):
            kind = self.kinds[mean.kind, number]
            radius, blur = p[:t][kind], p[t : 2 * t][kind]
            away = mean.offset - step
            far = np.hypot(*away.T)
            if self.sides:
                seen = np.prod([_blurred_edge(radius - np.abs(away @ n), blur, width) for n in self.normals], axis=0)
            else:
                seen = _blurred_disc(far, radius, blur, width)
            if len(self.cut):
                seen = seen * _blurred_edge(self.cut[3] - np.hypot(*(away - shift).T), 2 * self.cut[4], width)
            total += p[2 * t : 3 * t][kind] * (1 + p[-2] * np.minimum(far / radius, 1.2) ** 2) * seen
        return total

    def fit(self, mean: _Mean, start: Array, shift: Array) -> tuple[Array, float]:
        """Parameters that explain mean microimages best, and the weighted RMS of what is left."""
        from scipy.optimize import least_squares

        root = np.sqrt(mean.weight / mean.weight.mean())
        repeats = [self.count] * 3 + [1, 1]
        low = np.repeat([0.1 * self.pitch, 0.05, 0.3, -1.0, -0.1], repeats)
        high = np.repeat([0.8 * self.pitch, 0.5 * self.pitch, 1.7, 1.0, 0.9], repeats)
        # Shading and stray light that the pixels do not tell stay about 0 and 0.02.
        stiff = 0.002 * np.sqrt(len(root)) / np.array([0.3, 0.2])

        def miss(p: Array) -> Array:
            return np.append(root * (self.light(mean, p, shift) - mean.light), stiff * (p[-2:] - [0, 0.02]))

        found = least_squares(
            miss, np.clip(start, low, high), bounds=(low, high), loss="soft_l1", f_scale=0.03, ftol=1e-4, xtol=1e-4,
            max_nfev=25,
        )  # fmt: skip
        return found.x, float(np.sqrt((miss(found.x)[: len(root)] ** 2).mean()))


def _blurred_disc(far: Array, radius: Array, blur: Array, width: float) -> Array:
    """Share of discs of radius `blur` at distances `far` from the middle of discs of `radius` that lies in these, seen
    by squares of `width` [px]: mean over three places across one (Gauss and Legendre)."""
    seen = (far < radius).astype(np.float64)
    near = np.flatnonzero(np.abs(far - radius) < blur + width / 2)
    radius, blur = radius[near], blur[near]
    seen[near] = 0
    for place, weight in _ACROSS_PIXEL:
        r = np.maximum(far[near] + width * place, 1e-9)
        one = np.clip((r**2 + blur**2 - radius**2) / (2 * r * blur), -1, 1)
        two = np.clip((r**2 + radius**2 - blur**2) / (2 * r * radius), -1, 1)
        area = blur**2 * (np.arccos(one) - one * np.sqrt(1 - one**2))
        area += radius**2 * (np.arccos(two) - two * np.sqrt(1 - two**2))
        seen[near] += weight * area / (np.pi * blur**2)
    return seen


def _blurred_edge(depth: Array, blur: Array | float, width: float) -> Array:
    """Share of discs of radius `blur` at `depth` [px] inside a straight edge that lies inside it, the same way."""
    seen = np.zeros(len(depth))
    for place, weight in _ACROSS_PIXEL:
        t = np.clip((depth + width * place) / blur, -1, 1)
        seen += weight * (0.5 + (t * np.sqrt(1 - t**2) + np.arcsin(t)) / np.pi)
    return seen


def decode_srgb(values: NDArray[Any]) -> NDArray[Any]:
    """Light of values of 0 to 1 that are encoded by the sRGB curve (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((np.maximum(values, 0.04045) + 0.055) / 1.055) ** 2.4)


def _make_model(camera: Calibration) -> _Model:
    lattice, types = camera.lattice, camera.lens_types
    around = np.vstack([np.zeros((1, 2), np.int64), lattice.steps])
    kinds = np.zeros((1, len(around)), np.int64)
    if types is not None:
        firsts = [np.argwhere(types.cell == kind)[0] for kind in range(types.count)]
        kinds = np.array([types.of(first + around) for first in firsts], np.int64)
    half = (lattice.steps @ lattice.basis)[: len(lattice.steps) // 2]
    cut = np.zeros(0) if camera.gain_map is None else camera.gain_map.cut
    return _Model(around @ lattice.basis, kinds, half / np.hypot(*half.T)[:, None], cut, lattice.pitch)


def _average_tiles(flat: NDArray[Any], camera: Calibration, encoded: bool, count: int) -> list[_Tile]:
    """Mean microimages of up to 25 tiles of the flat, that of the middle first."""
    lattice, types = camera.lattice, camera.lens_types
    cell = Cell.of(lattice)
    indices, centres = select_whole_lenses(lattice, cell.circumradius + 2)
    dead = set(map(tuple, camera.defects.lenses.tolist()))
    lit = np.array([tuple(lens) not in dead for lens in indices.tolist()], dtype=bool)
    indices, centres = indices[lit], centres[lit]
    kinds = np.zeros(len(indices), np.int64) if types is None else types.of(indices).astype(np.int64)
    number = int(np.clip(np.sqrt(len(indices) / (30 * count)), 1, 5 if count == 1 else 4))
    which = (centres / lattice.image_size * number).astype(int)
    tiles = []
    for at in sorted(product(range(number), repeat=2), key=lambda at: np.hypot(*(2 * np.array(at) - number + 1))):
        own = np.flatnonzero((which == at).all(1))
        if len(own) < 4 * count:
            continue
        # As many lenses as have 60,000 pixels.
        own = own[:: max(1, int(len(own) * abs(np.linalg.det(lattice.basis)) / 6e4))]
        mean, light = _average(flat, camera, cell, encoded, centres[own], kinds[own])
        if mean is not None and len(np.unique(mean.kind)) == count:
            tiles.append(_Tile(field_place(centres[own].mean(0)[None], lattice)[0], mean, light))
    typical = float(np.median([tile.light for tile in tiles])) if tiles else 0.0
    return [tile for tile in tiles if tile.light > 0.1 * typical]


def _fit_middle(model: _Model, tile: _Tile, lattice: Lattice) -> tuple[_Model, Array, float]:
    """The round model, or that with straight sides if it is better, its parameters and the RMS of what is left."""
    start, shift = model.start(0.93 * nearest_half(lattice)), model.shift(tile.place)
    tries = []
    for one in (model, replace(model, sides=len(lattice.steps))):
        tries.append((one, *one.fit(tile.mean, start, shift)))
    return tries[1] if tries[1][2] < 0.8 * tries[0][2] else tries[0]


def _fit_tiles(model: _Model, tiles: list[_Tile], start: Array) -> MicroimageField:
    """Fields through what tiles show, from the parameters of the first tile."""
    fits = [start, *(model.fit(tile.mean, start, model.shift(tile.place))[0] for tile in tiles[1:])]
    table, place, t = np.array(fits), np.array([tile.place for tile in tiles]), model.count
    light, blurs, mean = np.array([tile.light for tile in tiles]), 2 * table[:, t : 2 * t], tiles[0].mean
    faults = [float(np.hypot(_BLUR_SHARE * d, _BLUR_FAULT / max(d, 0.5))) for d in np.median(blurs, axis=0)]
    own = np.flatnonzero(mean.kind == 0)
    own = own[np.argsort(np.hypot(*mean.offset[own].T))]
    modelled = model.light(mean, start, model.shift(tiles[0].place))
    of_shape = np.hypot(_SHAPE_FAULT * float(np.median(blurs)), _SIDES_FAULT * bool(model.sides))
    return MicroimageField(
        place, table[:, :t],
        fit_field(place, table[:, :t].mean(1), _RADIUS_FAULT, float(of_shape)),
        tuple(fit_field(place, values, fault) for values, fault in zip(blurs.T, faults, strict=True)),
        fit_field(place, np.log(light), _LIGHT_FAULT), model.sides,
        (np.hypot(*mean.offset[own].T), mean.light[own], modelled[own]),
    )  # fmt: skip


def fit_field(place: Array, values: Array, fault: float, common: float = 0.0) -> Field:
    """Smooth field through values (n,) of tiles, with an error of the model, and one that all of them share."""
    x, y = place.T
    table = np.column_stack([np.ones(len(x)), x, y, x * x + y * y])
    # Fewer tiles tell fewer terms.
    terms = 4 if len(x) >= 8 else 1
    table = table[:, :terms] - np.append(0, table[:, 1:terms].mean(0))
    middle = np.append(1, -np.column_stack([x, y, x * x + y * y])[:, : terms - 1].mean(0))
    weight = np.ones(len(x))
    for _ in range(5):
        root = weight[:, None] * table
        inverse = np.linalg.pinv(root.T @ table)
        factors = inverse @ root.T @ values
        miss = values - table @ factors
        limit = 3 * 1.4826 * float(np.median(np.abs(miss))) + 1e-9
        weight = np.minimum(1, limit / np.maximum(np.abs(miss), 1e-12))
    free = len(x) - terms
    spread = float((weight * miss**2).sum() / free) if free > 0 else float("inf")
    variance = spread * inverse
    error = float(np.sqrt(middle @ variance @ middle + fault**2 + common**2)) if free > 0 else float("inf")
    if terms == 1:
        return Field(float(factors[0]), error, np.full(2, np.nan), float("inf"), float("nan"), float("inf"))
    slope_error = float(np.hypot(np.sqrt((variance[1, 1] + variance[2, 2]) / 2), fault))
    bend_error = float(np.hypot(np.sqrt(variance[3, 3]), fault))
    return Field(float(middle @ factors), error, factors[1:3], slope_error, float(factors[3]), bend_error)


def _average(
    flat: NDArray[Any], camera: Calibration, cell: Cell, encoded: bool, centres: Array, kinds: NDArray[np.int64]
) -> tuple[_Mean | None, float]:
    """The mean microimage of each type of the lenses of a tile, and the light of their middles."""
    reach = int(np.ceil(cell.circumradius)) + 1
    # A mosaic begins at even pixels.
    low = np.maximum(np.floor(centres.min(0)).astype(int) - reach - 1, 0) // 2 * 2
    high = np.ceil(centres.max(0)).astype(int) + reach + 2
    part = flat[low[1] : high[1], low[0] : high[0]]
    light = equalise_mosaic(part) if camera.mosaic and part.ndim == 2 else luminance(part)
    if encoded:
        top = camera.white_level or (float(np.iinfo(flat.dtype).max) if flat.dtype.kind == "u" else 1.0)
        light = decode_srgb(light / top).astype(np.float32)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    whole = np.rint(centres).astype(int)
    value = light[whole[:, 1, None, None] - low[1] + y, whole[:, 0, None, None] - low[0] + x]
    offset = (whole - centres)[:, None, None] + np.stack([x, y], -1)
    far = np.hypot(offset[..., 0], offset[..., 1])
    middle = far < 0.5 * cell.inradius
    core = (value * middle).sum((1, 2)) / middle.sum((1, 2))
    typical = float(np.median(core))
    keep = core > 0.3 * typical
    if typical <= 0 or keep.sum() < 4:
        return None, 0.0
    value, offset, kinds = value[keep] / core[keep, None, None], offset[keep], kinds[keep]
    inside = (offset @ cell.normals.T <= 0.52).all(-1)
    # Squares of half a pixel to one, forty across, or thirty where there are several types.
    side = float(np.clip(cell.circumradius / (14 if kinds.any() else 20), 0.5, 1.0))
    across = int(2 * reach / side) + 3
    square = np.floor((offset + reach) / side).astype(np.int64) + 1
    key = (kinds[:, None, None] * across + square[..., 1]) * across + square[..., 0]
    for last in (False, True):
        own = key[inside]
        number = np.bincount(own)
        mean = np.bincount(own, value[inside]) / np.maximum(number, 1)
        if not last:
            miss = np.where(inside, value - mean[np.minimum(key, len(mean) - 1)], 0)
            scatter = np.sqrt((miss**2).sum((1, 2)) / np.maximum(inside.sum((1, 2)), 1))
            # Lenses behind dust.
            inside &= (scatter <= 2.5 * np.median(scatter))[:, None, None]
    filled = np.flatnonzero(number)
    places = [np.bincount(own, offset[inside][:, axis])[filled] / number[filled] for axis in (0, 1)]
    kind = filled // across**2
    return _Mean(kind, side, np.column_stack(places), mean[filled], number[filled].astype(float)), typical
