"""First lattice of a large white image: found in one piece, extended over the flat.

A fit needs some lenses from all over the field, not every pixel. Pieces are taken ever farther out,
each so near to those before that a distortion is measured before it has moved centres to the next
lens.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from ..detection.search import Candidate, find_candidates
from ..detection.tones import is_white_image
from ..images.mosaic import equalise_mosaic
from ..images.preprocessing import luminance
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import ReadCrop, StackedCrops
from ..runtime.arrays import Array, Singles
from ..runtime.errors import CalibrationError
from .fit import refine_on_parts

#: Least probability of a lattice in a piece.
_LIKELY = 0.8
#: [px] Least side of the piece that a lattice is searched for in, and of those it is extended on.
_FIRST_SIDE = 768
_PIECE_SIDE = 256
#: [pitch] Least side of pieces.
_PIECE_PITCHES = 14
#: Pixels of the parts that a large flat is calibrated on.
_PIXELS = 1.6e7
#: Parts in which the light is compared with that of white images.
_EVEN_PARTS = 9
#: Distance of pieces from the middle over that of the pieces before. A cubic that moves centres by
#: hardly 0.01 px up to the last pieces moves them by 0.16 px so far out.
_FARTHER = 2.5
#: Places of the pieces that a lattice is searched for in, as shares of the flat: the middle first.
_PLACES = (0.5, 0.2, 0.8)

__all__ = ["find_white_lattice", "sample_parts", "window_reader"]


def window_reader(flat: Array, filtered: bool) -> ReadCrop:
    """Function that reads windows of the square root of the light of a flat.

    The flat is (h, w) or (h, w, 3); `filtered` if it has a colour mosaic.
    """

    def read(x: int, y: int, width: int, height: int) -> Singles:
        raw = np.ascontiguousarray(flat[y : y + height, x : x + width])
        light = equalise_mosaic(raw) if filtered else luminance(raw)
        return np.sqrt(np.maximum(light, 0, out=light), out=light)

    return read


def sample_parts(
    read: ReadCrop, lattice: Lattice, side: int = _FIRST_SIDE, pixels: float = _PIXELS
) -> tuple[StackedCrops, ReadCrop]:
    """Parts of a flat, enough to calibrate on, and a reader of all of it; their mean is 1.

    Parts are of this `side` [px] and have about so many `pixels` in all.
    """
    parts = _sample_grid(read, lattice.image_size, side, pixels)
    scale = np.float32(1 / max(float(parts.picture.mean(dtype=np.float64)), 1e-30))
    np.multiply(parts.picture, scale, out=parts.picture)
    return parts, lambda x, y, width, height: read(x, y, width, height) * scale


def _sample_grid(read: ReadCrop, size: tuple[int, int], side: int, pixels: float) -> StackedCrops:
    """Square parts of a flat of this `size`, evenly spread from border to border.

    Together they have about this number of `pixels`.
    """
    count = max(pixels / side**2, 1.0)
    columns = max(1, min(round(np.sqrt(count * size[0] / size[1])), size[0] // side))
    rows = max(1, min(round(count / columns), size[1] // side))
    # Even coordinates: a colour mosaic begins with the same colour in all parts.
    xs, ys = (
        np.linspace(0, length - side, n).astype(np.int64) // 2 * 2
        for length, n in zip(size, (columns, rows), strict=True)
    )
    return _stack(read, [(x, y) for y in ys.tolist() for x in xs.tolist()], side)


def _stack(read: ReadCrop, corners: list[tuple[int, int]], side: int) -> StackedCrops:
    picture = np.concatenate([read(x, y, side, side) for x, y in corners])
    return StackedCrops(picture, np.array(corners, dtype=np.int64), (side, side))


def find_white_lattice(
    read: ReadCrop,
    size: tuple[int, int],
    sure: bool,
    tries: int,
) -> Candidate | None:
    """First lattice of a white image, with its distortion.

    None if the flat is no white image, or if no lattice is found.

    `read` gives the square root of the light in any scale, `size` is width and height of the flat
    [px]. `sure` if it is known to be a white image. The lattice is searched for in a piece of
    768 px in at most `tries` places, from the middle outwards, and extended on pieces of 14 pitches
    and at least 256 px.
    """
    found = _find_in_piece(read, size, sure, tries, min(_FIRST_SIDE, *size))
    if found is None:
        return None
    start, corner, first_side = found
    lattice = start.lattice
    side = max(int(_PIECE_PITCHES * lattice.pitch), _PIECE_SIDE)
    pieces: list[tuple[int, int]] = []
    middle = np.array(corner) + first_side / 2
    distance = float(first_side)
    while True:
        known = len(pieces)
        for dy in (-1, 0, 1):
            for dx in (-1, 0, 1):
                place = (middle + distance * np.array([dx, dy]) - side / 2).astype(int) // 2 * 2
                x, y = np.clip(place, 0, np.array(size) - side).tolist()
                apart = all(max(abs(x - u), abs(y - v)) >= side for u, v in pieces)
                if apart and max(abs(x - corner[0]), abs(y - corner[1])) >= max(side, first_side):
                    pieces.append((x, y))
        distance *= _FARTHER
        if len(pieces) == known:
            break
        try:
            lattice = refine_on_parts(_stack(read, pieces, side), lattice)
        except CalibrationError:
            # Nothing is lit so near: the present lattice may reach farther.
            continue
    if not sure and not _is_even(read, size, lattice):
        return None
    return replace(start, lattice=lattice)


def _find_in_piece(
    read: ReadCrop, size: tuple[int, int], sure: bool, tries: int, side: int
) -> tuple[Candidate, tuple[int, int], int] | None:
    """Lattice of the first piece that shows one, in pixels of the flat.

    Also returns corner and side of the piece [px].
    """
    for place in sorted(
        product(_PLACES, repeat=2), key=lambda p: abs(p[0] - 0.5) + abs(p[1] - 0.5)
    )[:tries]:
        x, y = (
            int(share * (length - side)) // 2 * 2 for share, length in zip(place, size, strict=True)
        )
        picture = read(x, y, side, side)
        mean = float(picture.mean())
        if not mean > 0:
            continue
        picture = picture / np.float32(mean)
        try:
            start = _find_start(picture, sure, quick=tries == 1 and not sure)
        except (CalibrationError, np.linalg.LinAlgError):
            continue
        own = start.lattice
        # Ten pitches fit into the piece.
        if start.evidence.probability < _LIKELY or own.pitch * 10 > side:
            continue
        if not sure and start.evidence.white_probability < 0.5:
            return None
        moved = Lattice(own.origin + np.array([x, y]), own.basis, size, own.radius)
        return replace(start, lattice=moved), (x, y), side
    return None


def _find_start(picture: Singles, sure: bool, quick: bool) -> Candidate:
    """The most probable lattice of a piece (h, w).

    In a `quick` search the strongest period tells scenes from white images: many periods of a scene
    would be measured before it is found to be none.
    """
    if quick:
        first = find_candidates(picture, periods=1)[0]
        if first.evidence.is_certain or first.evidence.white_probability <= 0.5:
            return first
    return find_candidates(picture, stated_white=float(sure))[0]


def _is_even(read: ReadCrop, size: tuple[int, int], lattice: Lattice) -> bool:
    """Whether microimages are evenly lit all over the field.

    Parts of whole lenses are compared with their neighbours.
    """
    side = max(int(_PIECE_PITCHES * lattice.pitch), _PIECE_SIDE)
    parts = _sample_grid(read, size, side, _EVEN_PARTS * side**2)
    even = []
    for number, corner in enumerate(parts.corners):
        own = Lattice(lattice.origin - corner, lattice.basis, parts.size, lattice.radius)
        part = parts.crop(number)
        even.append(is_white_image(part / np.float32(max(float(part.mean()), 1e-30)), own))
    return bool(np.mean(even) > 0.5)
