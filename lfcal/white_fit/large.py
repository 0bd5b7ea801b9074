"""First lattice of a large white image: found in one piece of the flat, then extended outwards over all of it.

A fit needs some lenses from all over the field, not every pixel. Pieces are taken ever farther out, each so near to
those before that a distortion is measured before it has moved centres to the next lens.
"""

from __future__ import annotations

from dataclasses import replace
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
from .settings import LARGE, LargeSettings

__all__ = ["find_white_lattice", "find_white_lattice_in_array", "sample_grid", "sample_parts", "window_reader"]

# Rings of pieces around the first one, at most; each is farther out by `LargeSettings.spacing`.
_MOST_RINGS = 64


def window_reader(flat: NDArray[Any], filtered: bool) -> ReadCrop:
    """Reader of the square root of the light of a flat (h, w) or (h, w, 3), `filtered` by a colour mosaic."""

    def read(x: int, y: int, width: int, height: int) -> NDArray[np.float32]:
        raw = np.ascontiguousarray(flat[y : y + height, x : x + width])
        light = equalise_mosaic(raw) if filtered else luminance(raw)
        return np.sqrt(np.maximum(light, 0, out=light), out=light)

    return read


def sample_parts(read: ReadCrop, lattice: Lattice, settings: LargeSettings = LARGE) -> tuple[StackedCrops, ReadCrop]:
    """Parts of a flat, enough to calibrate on, and a reader of all of it, both scaled to a mean of 1 over the parts."""
    parts = sample_grid(read, lattice.image_size, settings.sample_side, settings.sample_pixels)
    scale = np.float32(1 / max(float(parts.picture.mean(dtype=np.float64)), 1e-30))
    np.multiply(parts.picture, scale, out=parts.picture)

    def read_scaled(x: int, y: int, width: int, height: int) -> NDArray[np.float32]:
        tones = read(x, y, width, height)
        tones *= scale
        return tones

    return parts, read_scaled


def sample_grid(read: ReadCrop, size: tuple[int, int], side: int, pixels: float) -> StackedCrops:
    """Square parts of a flat of this `size`, evenly spread from border to border, of about so many pixels in all."""
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
    picture = np.empty((len(corners) * side, side), np.float32)
    for number, (x, y) in enumerate(corners):
        picture[number * side : (number + 1) * side] = read(x, y, side, side)
    return StackedCrops(picture, np.array(corners, dtype=np.int64), (side, side))


def find_white_lattice_in_array(tones: NDArray[np.float32], sure: bool) -> FirstLattice | None:
    """`find_white_lattice` in the square root (h, w) of the light of a whole flat."""

    size = tones.shape[1], tones.shape[0]
    return find_white_lattice(lambda x, y, w, h: np.ascontiguousarray(tones[y : y + h, x : x + w]), size, sure, 1)


def find_white_lattice(
    read: ReadCrop, size: tuple[int, int], sure: bool, tries: int, settings: LargeSettings = LARGE
) -> FirstLattice | None:
    """First lattice of a white image, with its distortion; None if the flat is no white image, or no lattice is found.

    `read` gives the square root of the light in any scale, `size` is width and height of the flat [px]. `sure` if it is
    known to be a white image. The lattice is searched for in at most `tries` places, from the middle outwards.
    """
    found = _find_in_piece(read, size, sure, tries, settings)
    if found is None:
        return None
    start, corner, first_side = found
    lattice = start.lattice
    side = max(int(settings.piece_pitches * lattice.pitch), settings.piece_side)
    pieces: list[tuple[int, int]] = []
    middle = np.array(corner) + first_side / 2
    distance = float(first_side)
    for _ in range(_MOST_RINGS):
        known = len(pieces)
        for dy in (-1, 0, 1):
            for dx in (-1, 0, 1):
                corner_here = (middle + distance * np.array([dx, dy]) - side / 2).astype(int) // 2 * 2
                x, y = np.clip(corner_here, 0, np.array(size) - side).tolist()
                apart = all(max(abs(x - u), abs(y - v)) >= side for u, v in pieces)
                if apart and max(abs(x - corner[0]), abs(y - corner[1])) >= max(side, first_side):
                    pieces.append((x, y))
        distance *= settings.spacing
        if len(pieces) == known:
            break
        try:
            lattice = refine_on_parts(_stack(read, pieces, side), lattice)
        except CalibrationError:
            # Nothing is lit so near: the present lattice may reach farther.
            continue
    if not sure and not _is_even(read, size, lattice, settings):
        return None
    return replace(start, lattice=lattice)


def _find_in_piece(
    read: ReadCrop, size: tuple[int, int], sure: bool, tries: int, settings: LargeSettings
) -> tuple[FirstLattice, tuple[int, int], int] | None:
    """Lattice of the first piece that shows one, in px of the flat; corner and side of the piece [px]."""
    side = min(settings.first_side, *size)
    places = [(x, y) for x in (0.5, 0.2, 0.8) for y in (0.5, 0.2, 0.8)]
    for place in sorted(places, key=lambda p: abs(p[0] - 0.5) + abs(p[1] - 0.5))[:tries]:
        x, y = (int(share * (length - side)) // 2 * 2 for share, length in zip(place, size, strict=True))
        picture = read(x, y, side, side)
        mean = float(picture.mean())
        if not mean > 0:
            continue
        picture = picture / np.float32(mean)
        try:
            start = find_first_lattice(picture)
        except CalibrationError:
            continue
        own = start.lattice
        if start.repeatability < settings.repeatability or own.pitch * settings.first_periods > side:
            continue
        if not sure and not is_evenly_lit(start.brightness, picture**2, own):
            return None
        moved = Lattice(own.origin + np.array([x, y]), own.basis, size, own.radius)
        return replace(start, lattice=moved), (x, y), side
    return None


def _is_even(read: ReadCrop, size: tuple[int, int], lattice: Lattice, settings: LargeSettings) -> bool:
    """Whether microimages are evenly lit all over the field."""
    side = max(int(settings.even_pitches * lattice.pitch), settings.piece_side)
    pixels = max(settings.even_parts * settings.piece_side**2, settings.fewest_even_parts * side**2)
    parts = sample_grid(read, size, side, pixels)
    window = settings.window * lattice.pitch
    levelled = np.concatenate([normalise_locally(parts.crop(k), window) for k in range(len(parts))])
    return is_evenly_lit(replace(parts, picture=levelled), parts.picture**2, lattice)
