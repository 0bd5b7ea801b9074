"""Random pictures that are not raw flats of a lens array.

They show photographs, screens with text, charts, print, cloth, walls, tilings, boards and meshes.
Many of them have patterns that repeat.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["KINDS", "draw_no_flat"]

_SIZE = (1100, 800)
_PHOTOGRAPHS = (
    "astronaut",
    "brick",
    "camera",
    "cell",
    "chelsea",
    "coffee",
    "coins",
    "grass",
    "gravel",
    "hubble_deep_field",
    "ihc",
    "moon",
    "motorcycle_left",
    "page",
    "retina",
    "rocket",
    "text",
)


def _coordinates(rng: np.random.Generator, most: float = 10.0) -> tuple[NDArray[Any], NDArray[Any]]:
    """Coordinates (h, w) [px] of the pixels, rotated by a random angle up to a limit [degrees]."""
    angle = np.radians(rng.uniform(-most, most))
    y, x = np.mgrid[0 : _SIZE[1], 0 : _SIZE[0]].astype(float)
    return np.cos(angle) * x + np.sin(angle) * y + 1e4, np.cos(angle) * y - np.sin(angle) * x + 1e4


def _photograph(rng: np.random.Generator) -> NDArray[Any]:
    import skimage.data

    folder = Path(skimage.data.__file__).parent
    found = [path for name in _PHOTOGRAPHS for path in folder.glob(f"{name}.*")]
    picture = cv2.imread(str(rng.choice([str(path) for path in found])), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    return picture.astype(float)


def _leaves(rng: np.random.Generator) -> NDArray[Any]:
    """Discs that hide each other: contrasts and sizes are those of natural scenes."""
    picture = np.full(_SIZE[::-1], 128, np.uint8)
    for _ in range(1500):
        radius = int(min(4 * rng.random() ** -0.6, 250))
        place = (int(rng.integers(0, _SIZE[0])), int(rng.integers(0, _SIZE[1])))
        cv2.circle(picture, place, radius, float(rng.uniform(0, 255)), -1)
    return picture


def _page(rng: np.random.Generator) -> NDArray[Any]:
    """A screen with columns of text, boxes and pictures; text stands on lines of one height."""
    light = bool(rng.random() < 0.7)
    picture = np.full(_SIZE[::-1], 250 if light else 30, np.uint8)
    ink = 20.0 if light else 220.0
    line = int(rng.integers(12, 26))
    size = float(rng.uniform(0.3, 0.6))
    columns = int(rng.integers(1, 4))
    letters = list("abcdefghijklmnopqrstuvwxyz     .,")
    for column in range(columns):
        left = column * _SIZE[0] // columns + 12
        wide = _SIZE[0] // columns - 24
        for y in range(line, _SIZE[1], line):
            if rng.random() < 0.85:
                count = int(wide / (18 * size) * rng.uniform(0.3, 1))
                text = "".join(rng.choice(letters, count))
                cv2.putText(
                    picture, text, (left, y), cv2.FONT_HERSHEY_SIMPLEX, size, ink, 1, cv2.LINE_AA
                )
    for _ in range(int(rng.integers(0, 6))):
        x, y, w, h = (
            int(v) for v in (rng.integers(0, 900), rng.integers(0, 600), *rng.integers(40, 300, 2))
        )
        cv2.rectangle(picture, (x, y), (x + w, y + h), float(rng.uniform(40, 230)), -1)
    return picture


def _terminal(rng: np.random.Generator) -> NDArray[Any]:
    """Letters that stand on a grid, as in terminals and tables."""
    picture = np.full(_SIZE[::-1], 20, np.uint8)
    wide = int(rng.integers(8, 14))
    high = int(rng.integers(14, 24))
    for y in range(high, _SIZE[1], high):
        for x in range(0, int(_SIZE[0] * rng.uniform(0.3, 1)), wide):
            letter = chr(int(rng.integers(33, 126)))
            cv2.putText(
                picture, letter, (x, y), cv2.FONT_HERSHEY_PLAIN, wide / 12, 220.0, 1, cv2.LINE_AA
            )
    return picture


def _icons(rng: np.random.Generator) -> NDArray[Any]:
    """Thumbnails on a grid with light gaps: another picture in each."""
    picture = np.full(_SIZE[::-1], 245, np.uint8)
    step = int(rng.integers(30, 110))
    gap = int(rng.integers(2, 12))
    other = _leaves(rng)
    for y in range(gap, _SIZE[1] - step, step):
        for x in range(gap, _SIZE[0] - step, step):
            part = other[rng.integers(0, 700) :, rng.integers(0, 1000) :][
                : step - gap, : step - gap
            ]
            picture[y : y + part.shape[0], x : x + part.shape[1]] = part
    return picture


def _chart(rng: np.random.Generator) -> NDArray[Any]:
    """Curves on a grid."""
    picture = np.full(_SIZE[::-1], 255, np.uint8)
    step = [int(v) for v in rng.integers(20, 120, 2)]
    ink = float(rng.uniform(80, 220))
    picture[:: step[0]] = ink
    picture[:, :: step[1]] = ink
    x = np.arange(_SIZE[0])
    for _ in range(int(rng.integers(1, 6))):
        y = 400 + np.cumsum(rng.normal(0, 4, _SIZE[0])) + rng.uniform(-200, 200)
        points = np.column_stack([x, np.clip(y, 0, _SIZE[1])]).astype(np.int32)
        cv2.polylines(picture, [points], False, float(rng.uniform(0, 120)), 2, cv2.LINE_AA)
    return picture


def _bars(rng: np.random.Generator) -> NDArray[Any]:
    picture = np.full(_SIZE[::-1], 255, np.uint8)
    picture[:: int(rng.integers(20, 90))] = 200.0
    step = int(rng.integers(8, 40))
    for x in range(0, _SIZE[0], step):
        picture[int(rng.uniform(0, _SIZE[1])) :, x : x + int(0.7 * step)] = 90.0
    return picture


def _weave(rng: np.random.Generator) -> NDArray[Any]:
    """A plain weave or a twill."""
    u, v = _coordinates(rng)
    period = rng.uniform(4, 20)
    shift = int(rng.integers(2, 5))
    i = np.floor(u / period)
    j = np.floor(v / period)
    along = np.cos(np.pi * (u / period - i - 0.5))
    across = np.cos(np.pi * (v / period - j - 0.5))
    over = (i - j) % (2 * shift - 2) < shift - 1
    return 60 + 150 * np.where(over, across * (0.75 + 0.25 * along), along * (0.75 + 0.25 * across))


def _knit(rng: np.random.Generator) -> NDArray[Any]:
    """Stitches, printed with a picture."""
    u, v = _coordinates(rng)
    period = rng.uniform(10, 30)
    phase = v / period + 0.35 * np.abs((u / period) % 1 - 0.5) * 2
    return (80 + 100 * np.abs(np.sin(np.pi * phase)) * np.abs(np.cos(np.pi * u / period))) * _tint(
        rng
    )


def _tint(rng: np.random.Generator) -> NDArray[Any]:
    """Smooth light of random places."""
    small = rng.uniform(0.4, 1.3, (5, 7)).astype(np.float32)
    return np.asarray(cv2.resize(small, _SIZE, interpolation=cv2.INTER_CUBIC), dtype=float)


def _board(rng: np.random.Generator) -> NDArray[Any]:
    u, v = _coordinates(rng)
    side = rng.uniform(12, 70)
    return 30 + 190 * ((np.floor(u / side) + np.floor(v / side)) % 2)


def _tiles(rng: np.random.Generator, joint: float, offset: float) -> NDArray[Any]:
    """Tiles of random tones, with joints; `offset` of one row against the next."""
    u, v = _coordinates(rng)
    wide = rng.uniform(25, 90)
    high = rng.uniform(25, 60)
    row = np.floor(v / high)
    column = np.floor((u + row * offset * wide) / wide)
    tones = rng.uniform(90, 200, (64, 64))
    tone = tones[row.astype(int) % 64, column.astype(int) % 64]
    width = rng.uniform(2, 5)
    between = ((u + row * offset * wide) % wide < width) | (v % high < width)
    return np.where(between, joint, tone) + cv2.GaussianBlur(
        rng.normal(0, 25, u.shape), (0, 0), 2.0
    )


def _hexagons(rng: np.random.Generator) -> NDArray[Any]:
    """Hexagonal tiles of random tones with joints."""
    u, v = _coordinates(rng)
    step = rng.uniform(20, 60)
    high = step * np.sqrt(0.75)
    # Of two rectangular lattices the nearer point.
    nearest = np.full(u.shape, np.inf)
    index = np.zeros(u.shape, int)
    border = np.full(u.shape, np.inf)
    for shift in (0, 1):
        i = np.rint(u / step - shift / 2)
        j = np.rint(v / (2 * high) - shift / 2)
        far = np.hypot(u - (i + shift / 2) * step, v - (j + shift / 2) * 2 * high)
        number = ((i.astype(int) * 7 + j.astype(int) * 13) * 2 + shift) % 997
        border = np.where(far < nearest, nearest - far, far - nearest)
        nearest, index = (
            np.where(far < nearest, far, nearest),
            np.where(far < nearest, number, index),
        )
    side = np.abs((u / step - np.where(index % 2, 0.5, 0)) % 1 - 0.5) * step
    joint = (np.minimum(border, 2 * side) < rng.uniform(2, 5)) & (nearest > 0.4 * step)
    return np.where(joint, rng.choice([30.0, 230.0]), rng.uniform(80, 210, 997)[index])


def _halftone(rng: np.random.Generator) -> NDArray[Any]:
    """A printed photograph: dots whose size is its tone."""
    picture = cv2.resize(_photograph(rng), _SIZE, interpolation=cv2.INTER_LINEAR)
    u, v = _coordinates(rng, 45.0)
    period = rng.uniform(6, 16)
    screen = 0.5 + 0.25 * (np.cos(2 * np.pi * u / period) + np.cos(2 * np.pi * v / period))
    return (
        np.clip((cv2.GaussianBlur(picture, (0, 0), 2.0) / 255 - screen) * 3 * period, -0.5, 0.5)
        * 220
        + 128
    )


def _mesh(rng: np.random.Generator) -> NDArray[Any]:
    """A picture behind a mesh of dark wires, or of round holes."""
    u, v = _coordinates(rng)
    period = rng.uniform(14, 50)
    behind = cv2.resize(_photograph(rng), _SIZE, interpolation=cv2.INTER_CUBIC)
    if rng.random() < 0.5:
        open_ = (u % period > 0.18 * period) & (v % period > 0.18 * period)
    else:
        odd = np.floor(v / period) % 2 * (rng.random() < 0.5)
        open_ = (
            np.hypot((u + odd * period / 2) % period - period / 2, v % period - period / 2)
            < 0.42 * period
        )
    return np.where(open_, behind, 20.0)


def _windows(rng: np.random.Generator) -> NDArray[Any]:
    """The front of a house: windows, some lit."""
    u, v = _coordinates(rng, 4.0)
    wide, high = rng.uniform(30, 80, 2)
    lit = rng.uniform(20, 240, (64, 64))[
        np.floor(v / high).astype(int) % 64, np.floor(u / wide).astype(int) % 64
    ]
    inside = (np.abs(u % wide / wide - 0.5) < 0.3) & (np.abs(v % high / high - 0.5) < 0.35)
    return np.where(inside, lit, 120.0) * (0.9 + 0.2 * _tint(rng))


def _stripes(rng: np.random.Generator) -> NDArray[Any]:
    u, _ = _coordinates(rng, 45.0)
    return 128 + 100 * np.sign(np.sin(2 * np.pi * u / rng.uniform(8, 60)))


KINDS: dict[str, Callable[[np.random.Generator], NDArray[Any]]] = {
    "photograph": _photograph,
    "leaves": _leaves,
    "page": _page,
    "terminal": _terminal,
    "thumbnails": _icons,
    "chart": _chart,
    "bars": _bars,
    "weave": _weave,
    "knit": _knit,
    "board": _board,
    "bricks": lambda rng: _tiles(rng, 215.0, 0.5),
    "tiles, light joints": lambda rng: _tiles(rng, 225.0, 0.0),
    "tiles, dark joints": lambda rng: _tiles(rng, 40.0, 0.0),
    "hexagons": _hexagons,
    "halftone": _halftone,
    "mesh": _mesh,
    "windows": _windows,
    "stripes": _stripes,
}


def draw_no_flat(seed: int) -> tuple[str, NDArray[np.uint8]]:
    """Name and picture (h, w) of seed `seed`, photographed with blur and noise: the kinds come in
    turn.
    """
    rng = np.random.default_rng(seed)
    name = list(KINDS)[seed % len(KINDS)]
    picture = KINDS[name](rng)
    blurred = cv2.GaussianBlur(picture, (0, 0), float(rng.uniform(0.4, 1.0)))
    return name, np.clip(
        blurred + rng.normal(0, rng.uniform(0.5, 4), picture.shape), 0, 255
    ).astype(np.uint8)
