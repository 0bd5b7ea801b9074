"""First lattice of a large white image: found in one piece of the flat, then followed outwards over all of it.

A fit needs some lenses from all over the field, not every pixel. Pieces are taken ever farther out, each time so near
to what is known that a distortion is seen before it has moved centres to the next lens.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..detection.capture_kind import is_evenly_lit
from ..detection.first_lattice import FirstLattice, find_first_lattice
from ..images.mosaic import equalise_mosaic
from ..images.preprocessing import luminance, normalise_locally
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import ReadCrop, StackedCrops
from ..runtime.errors import CalibrationError
from .fit import refine_on_parts

__all__ = ["find_white_lattice", "find_white_lattice_in_array", "sample_grid", "sample_parts", "window_reader"]

# Side of the piece in which the lattice is looked for [px]; at least so many pitches must be in it.
_PIECE = 768
_PERIODS = 10
# Two halves of a piece must show average microimages that correlate at least so much.
_REPEATS = 0.8
# Side of the pieces in which it is followed, in pitches and px, and of those by which white images are told.
_FOLLOW = (14, 256)
_WIDE = 2.0
# Pitches across a part in which lenses are seen whole with their surroundings, and so many parts all over the field:
# of short pitches, and of any.
_WHOLE = 6
_EVENLY, _FEWEST_PARTS = 25.0, 9.0
# From the pieces so far to the next ones. A cubic that moves centres by hardly a hundredth px within those then moves
# them by a sixth here.
_FARTHER = 2.5
# Side [px] and pixels of the parts that stand for a flat too large to be held as a whole.
_SIDE, _PIXELS = 768, 1.6e7


@dataclass(frozen=True)
class _Piece:
    x: int
    y: int
    side: int

    def apart(self, other: _Piece) -> bool:
        """Whether two pieces have no pixel in common."""
        return abs(self.x - other.x) >= max(self.side, other.side) or abs(self.y - other.y) >= max(
            self.side, other.side
        )


def window_reader(flat: NDArray[Any], filtered: bool) -> ReadCrop:
    """A look at the square root of the light of a flat (h, w) or (h, w, 3) of raw values, `filtered` by a mosaic."""

    def look(x: int, y: int, width: int, height: int) -> NDArray[np.float32]:
        raw = np.ascontiguousarray(flat[y : y + height, x : x + width])
        light = equalise_mosaic(raw) if filtered else luminance(raw)
        return np.sqrt(np.maximum(light, 0, out=light), out=light)

    return look


def find_white_lattice_in_array(tones: NDArray[np.float32], sure: bool) -> FirstLattice | None:
    """`find_white_lattice` of the tones (h, w) of a whole flat."""

    def look(x: int, y: int, width: int, height: int) -> NDArray[np.float32]:
        return np.ascontiguousarray(tones[y : y + height, x : x + width])

    return find_white_lattice(look, (tones.shape[1], tones.shape[0]), sure, tries=1)


def sample_parts(look: ReadCrop, lattice: Lattice) -> tuple[StackedCrops, ReadCrop]:
    """StackedCrops of a flat, enough to measure a camera on, and a look at all of it, both of mean tone 1."""
    parts = sample_grid(look, lattice.image_size, _SIDE, _PIXELS)
    scale = np.float32(1 / max(float(parts.picture.mean(dtype=np.float64)), 1e-30))
    np.multiply(parts.picture, scale, out=parts.picture)

    def scaled(x: int, y: int, width: int, height: int) -> NDArray[np.float32]:
        tones = look(x, y, width, height)
        tones *= scale
        return tones

    return parts, scaled


def sample_grid(look: ReadCrop, size: tuple[int, int], side: int, pixels: float) -> StackedCrops:
    """Square parts of a flat, evenly spread from border to border.

    Parameters
    ----------
    look : ReadCrop
        At tones of the flat, in whatever scale.
    size : (int, int) [px]
        Width and height of the flat.
    side : int [px]
    pixels : float
        In all parts together, about.
    """
    count = max(pixels / side**2, 1.0)
    columns = max(1, min(round(np.sqrt(count * size[0] / size[1])), size[0] // side))
    rows = max(1, min(round(count / columns), size[1] // side))
    # Even places, so that a colour mosaic begins alike in all parts.
    xs, ys = (
        np.linspace(0, length - side, n).astype(np.int64) // 2 * 2
        for length, n in zip(size, (columns, rows), strict=True)
    )
    corners = np.array([(x, y) for y in ys for x in xs], dtype=np.int64)
    picture = np.empty((len(corners) * side, side), np.float32)
    for number, (x, y) in enumerate(corners.tolist()):
        picture[number * side : (number + 1) * side] = look(x, y, side, side)
    return StackedCrops(picture, corners, (side, side))


def find_white_lattice(look: ReadCrop, size: tuple[int, int], sure: bool, tries: int) -> FirstLattice | None:
    """First lattice of a white image, with its distortion; None where the flat is none, or it is not found this way.

    Parameters
    ----------
    look : ReadCrop
        At tones of the flat, in whatever scale.
    size : (int, int) [px]
        Width and height of the flat.
    sure : bool
        The flat is known to be a white image.
    tries : int
        In so many places at most, from the middle outwards, the lattice is looked for.
    """
    found = _found(look, size, sure, tries)
    if found is None:
        return None
    start, piece = found
    lattice = start.lattice
    side = max(int(_FOLLOW[0] * lattice.pitch), _FOLLOW[1])
    pieces = [piece]
    middle = np.array([piece.x, piece.y]) + piece.side / 2
    distance = float(piece.side)
    for _ in range(64):
        known = len(pieces)
        for dy in (-1, 0, 1):
            for dx in (-1, 0, 1):
                x, y = (middle + distance * np.array([dx, dy]) - side / 2).astype(int) // 2 * 2
                one = _Piece(int(np.clip(x, 0, size[0] - side)), int(np.clip(y, 0, size[1] - side)), side)
                if all(one.apart(other) for other in pieces):
                    pieces.append(one)
        distance *= _FARTHER
        if len(pieces) == known:
            break
        try:
            lattice = refine_on_parts(_parts(look, pieces[1:], side), lattice)
        except CalibrationError:
            # Nothing is lit so near: what is known may reach farther.
            continue
    if not sure and not _even(look, size, lattice):
        return None
    return replace(start, lattice=lattice)


def _found(look: ReadCrop, size: tuple[int, int], sure: bool, tries: int) -> tuple[FirstLattice, _Piece] | None:
    """Lattice of the first piece that shows one, in px of the flat, and where it was."""
    side = min(_PIECE, *size)
    places = [(x, y) for x in (0.5, 0.2, 0.8) for y in (0.5, 0.2, 0.8)]
    for x, y in sorted(places, key=lambda p: abs(p[0] - 0.5) + abs(p[1] - 0.5))[:tries]:
        piece = _Piece(int(x * (size[0] - side)) // 2 * 2, int(y * (size[1] - side)) // 2 * 2, side)
        picture = look(piece.x, piece.y, side, side)
        mean = float(picture.mean())
        if not mean > 0:
            continue
        picture = picture / np.float32(mean)
        try:
            start = find_first_lattice(picture)
        except CalibrationError:
            continue
        if start.repeatability < _REPEATS or start.lattice.pitch * _PERIODS > side:
            continue
        if not sure and not is_evenly_lit(start.brightness, picture**2, start.lattice):
            return None
        own = start.lattice
        origin = own.origin + np.array([piece.x, piece.y])
        return replace(start, lattice=Lattice(origin, own.basis, size, own.radius)), piece
    return None


def _parts(look: ReadCrop, pieces: list[_Piece], side: int) -> StackedCrops:
    corners = np.array([(p.x, p.y) for p in pieces], dtype=np.int64)
    return StackedCrops(np.concatenate([look(p.x, p.y, side, side) for p in pieces]), corners, (side, side))


def _even(look: ReadCrop, size: tuple[int, int], lattice: Lattice) -> bool:
    """Whether microimages are evenly lit all over the field."""
    side = max(int(_WHOLE * lattice.pitch), _FOLLOW[1])
    parts = sample_grid(look, size, side, max(_EVENLY * _FOLLOW[1] ** 2, _FEWEST_PARTS * side**2))
    levelled = np.concatenate([normalise_locally(parts.part(k), _WIDE * lattice.pitch) for k in range(len(parts))])
    return is_evenly_lit(replace(parts, picture=levelled), parts.picture**2, lattice)
