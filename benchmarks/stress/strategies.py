"""Random cases drawn by `hypothesis`, which prefers plain values and ends of ranges."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from ..white_images import WhiteImage
from .plane_flats import CELLS, PlaneFlat

__all__ = ["drawable_planes", "lookalikes", "planes", "whites"]

_SEEDS = st.integers(0, 2**31)
_PHOTOGRAPHS = (
    "camera",
    "coins",
    "astronaut",
    "coffee",
    "chelsea",
    "page",
    "text",
    "brick",
    "grass",
)
_SIDE = (150, 400)
# Of a shorter wave [px] pixels show another one.
_LEAST_PERIOD = 4.0


def _between(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high)


def _log_between(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(float(np.log(low)), float(np.log(high))).map(
        lambda x: float(np.clip(np.exp(x), low, high))
    )


def _or_none(strategy: st.SearchStrategy[float]) -> st.SearchStrategy[float]:
    return st.one_of(st.just(0.0), strategy)


@st.composite
def planes(draw: st.DrawFn, largest: float = 3.0) -> PlaneFlat:
    """A plane with everything drawn at random, up to `largest` pitches of patch size, in one of
    four textures.
    """
    pitch = draw(_log_between(6, 50))
    side = int(np.clip(pitch * draw(_between(5, 20)), 80, 420))
    ratio = draw(_log_between(0.02, largest)) * draw(st.sampled_from([-1.0, 1.0]))
    texture = draw(st.sampled_from(["rich", "rich", "faint", "coarse", "periodic"]))
    contrasts = {
        "rich": (0.1, 0.4),
        "faint": (0.0, 0.06),
        "coarse": (0.05, 0.4),
        "periodic": (0.05, 0.3),
    }
    grain = draw(
        _between(0.15 * pitch, 0.6 * pitch)
        if texture == "coarse"
        else _between(1.5, 0.15 * pitch + 1.5)
    )
    shortest = max(0.12, _LEAST_PERIOD / pitch)
    slant = (0.0, 0.0)
    # D / s may lose or gain a third of itself over the flat.
    if draw(st.booleans()):
        slant = (draw(_between(-0.25, 0.25)) / abs(ratio), draw(_between(-0.25, 0.25)) / abs(ratio))
    return PlaneFlat(
        ratio=ratio,
        slant=slant,
        cell=draw(st.sampled_from(sorted(CELLS))),
        pitch=pitch,
        degrees=draw(_between(0, 360)),
        size=(side, int(side * draw(_between(0.5, 1)))),
        contrast=draw(_between(*contrasts[texture])),
        noise=draw(_or_none(_between(0, 0.1))),
        grain=grain,
        period=draw(_between(shortest, 1.0)) if texture == "periodic" else 0.0,
        fill=draw(_or_none(_between(0.8, 1))),
        exposure=draw(_between(0.05, 0.6)),
        kind=draw(st.sampled_from(["u1", "u2", "f4"])),
        seed=draw(_SEEDS),
    )


def drawable_planes() -> st.SearchStrategy[PlaneFlat]:
    """Planes whose neighbouring lenses share content, so that a picture can be checked."""
    return planes(0.7)


@st.composite
def whites(draw: st.DrawFn) -> tuple[WhiteImage, float]:
    """A white image with everything drawn at random, and its exposure."""
    pitch = draw(_log_between(6, 40))
    side = int(np.clip(pitch * draw(_between(5, 22)), 60, 440))
    truth = WhiteImage(
        draw(st.sampled_from(["hexagonal", "square"])),
        pitch,
        draw(_between(0, 360)),
        draw(_between(6, 40)),
        draw(st.sampled_from([8, 16])),
        strength=draw(_or_none(_between(-0.3, 0.3))),
        k1=draw(_or_none(_between(-0.01, 0.01))),
        hot=draw(st.integers(0, 40)),
        dust=draw(st.integers(0, 5)),
        fill=draw(_between(0.6, 1)),
        soft=draw(_between(0.3, 3)),
        gap=draw(_between(0, 0.6)),
        inner=draw(_between(0, 0.6)),
        outer=draw(_between(0, 0.8)),
        size=(side, int(max(40, side * draw(_between(0.4, 1))))),
        seed=draw(_SEEDS),
    )
    return truth, draw(_log_between(0.02, 2))


def _turned(draw: st.DrawFn) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    width = draw(st.integers(*_SIDE))
    height = draw(st.integers(*_SIDE))
    angle = np.radians(draw(_between(0, 180)))
    y, x = np.mgrid[:height, :width].astype(float)
    return np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x


def _grating(draw: st.DrawFn) -> NDArray[np.float64]:
    wave = np.sin(2 * np.pi * _turned(draw)[0] / draw(_log_between(6, 80)))
    return np.asarray(np.sign(wave) if draw(st.booleans()) else wave)


def _crossed_waves(draw: st.DrawFn) -> NDArray[np.float64]:
    u, v = _turned(draw)
    period = draw(_log_between(8, 60))
    ratio = draw(_between(1, 2))
    a = np.sin(2 * np.pi * u / period)
    b = np.sin(2 * np.pi * v / (ratio * period))
    return np.asarray(draw(st.sampled_from([a * b, (a + b) / 2])))


def _board(draw: st.DrawFn) -> NDArray[np.float64]:
    u, v = _turned(draw)
    side = draw(_log_between(6, 60))
    return np.asarray(2.0 * ((np.floor(u / side) + np.floor(v / side)) % 2) - 1)


def _bricks(draw: st.DrawFn) -> NDArray[np.float64]:
    u, v = _turned(draw)
    height = draw(_log_between(10, 40))
    ratio = draw(_between(1.5, 4))
    mortar = height * draw(_between(0.08, 0.25))
    row = np.floor(v / height)
    joint = ((u + row % 2 * ratio * height / 2) % (ratio * height) < mortar) | (v % height < mortar)
    return np.asarray(np.where(joint, 1.0, -1.0))


def _clouds(draw: st.DrawFn) -> NDArray[np.float64]:
    """Noise whose amplitude falls with a power of the frequency: of 0 white, of 1 like that of
    photographs.
    """
    width = draw(st.integers(*_SIDE))
    height = draw(st.integers(*_SIDE))
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(np.random.default_rng(draw(_SEEDS)).standard_normal((height, width)))
    noise = np.fft.irfft2(spectrum * frequency ** -draw(_between(0, 2)), s=(height, width))
    return np.asarray(noise / (3 * noise.std()))


def _photograph(draw: st.DrawFn) -> NDArray[np.float64]:
    from skimage import data

    picture = np.asarray(getattr(data, draw(st.sampled_from(_PHOTOGRAPHS)))(), np.float32)
    grey = picture if picture.ndim == 2 else picture[..., :3].mean(2)
    scale = draw(_between(0.7, 1.5))
    angle = draw(_between(0, 360))
    width = draw(st.integers(*_SIDE))
    height = draw(st.integers(*_SIDE))
    turn = cv2.getRotationMatrix2D((grey.shape[1] / 2, grey.shape[0] / 2), angle, scale)
    move = np.array([width, height]) / 2 - np.array(grey.shape[::-1]) / 2
    moved = np.column_stack([turn[:, :2], turn[:, 2] + move])
    return (
        np.asarray(
            cv2.warpAffine(grey, moved, (width, height), borderMode=cv2.BORDER_REFLECT), float
        )
        / 127.5
        - 1
    )


_PICTURES: tuple[Callable[[st.DrawFn], NDArray[np.float64]], ...] = (
    _grating,
    _crossed_waves,
    _board,
    _bricks,
    _clouds,
    _photograph,
)


@st.composite
def lookalikes(draw: st.DrawFn) -> tuple[str, NDArray[Any]]:
    """Name and (h, w) uint8 picture of a scene that is not an array of microimages."""
    what = draw(st.sampled_from(_PICTURES))
    picture = what(draw)
    blur = draw(_or_none(_between(0.3, 2)))
    picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), blur) if blur else picture, float)
    noise = draw(_between(0, 0.1)) * np.random.default_rng(draw(_SEEDS)).standard_normal(
        picture.shape
    )
    shown = np.clip(127.5 * (1 + draw(_between(0.1, 1)) * picture + noise), 0, 255).astype(np.uint8)
    return what.__name__.strip("_").replace("_", " "), shown
