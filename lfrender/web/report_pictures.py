"""The pictures of a report: drawn in all ways the toolkit knows, and made small enough to lie in the page itself."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal import Calibration
from lfcal.runtime.eight_bit import to_eight_bits

from ..data.depth_map import BINOCULAR, TELESCOPIC, DepthMap
from ..data.rendering import Rendering
from ..rendering.render import render
from ..rendering.traditional import traditional

__all__ = ["ReportPictures", "data_urls", "draw_pictures", "png_url"]

# A mode of fewer lenses than this is more likely a few errors than part of the scene.
_PRESENT = 0.01
# Size of a picture in the page and quality of its WebP, from the best to the smallest.
_STEPS = ((1.0, 92), (1.0, 78), (0.5, 85), (0.25, 85), (0.125, 80))
# WebP can hold no more pixels in a row.
_LONGEST = 16383


@dataclass(frozen=True)
class ReportPictures:
    """Pictures of one flat, to be compared.

    Parameters
    ----------
    sharp : Rendering
        All in focus.
    traditional : Rendering
    fixed : mapping of str to Rendering
        With one patch size for all lenses, by the mode it is typical of, on the grid of `sharp`.
    patch_size : mapping of str to float [px]
        The sizes of `fixed`.
    """

    sharp: Rendering
    traditional: Rendering
    fixed: Mapping[str, Rendering]
    patch_size: Mapping[str, float]


def draw_pictures(flat: NDArray, calibration: Calibration, depth: DepthMap) -> ReportPictures:
    """Draw a flat all in focus, traditionally, and with the median patch size of each mode that it shows.

    Raises
    ------
    FlatError, CalibrationError
        As `render`.
    """
    sharp = render(flat, calibration, depth)
    sizes = {}
    for name, mode in (("telescopic", TELESCOPIC), ("binocular", BINOCULAR)):
        found = depth.patch_size[depth.mode == mode]
        if found.size > _PRESENT * len(depth):
            sizes[name] = float(np.median(found))
    fixed = {name: render(flat, calibration, patch_size=size, scale=sharp.scale) for name, size in sizes.items()}
    return ReportPictures(sharp, traditional(flat, calibration), fixed, sizes)


def data_urls(pictures: Mapping[str, ArrayLike], most: int, white: float | None = None) -> tuple[dict[str, str], float]:
    """Pictures as WebP in data URLs, all of one quality, the best that fits.

    Parameters
    ----------
    pictures : mapping of str to (h, w) or (h, w, 3) array
    most : int
        Characters for all together.
    white : float, optional
        What is white in pictures of whole numbers of more than 8 bits; else the largest that their type holds.

    Returns
    -------
    urls : dict of str to str
    size : float
        Share of their width and height that is left, 1 for all of it.
    """
    import cv2

    shown = {name: to_eight_bits(_in_colour(np.asarray(picture)), white) for name, picture in pictures.items()}
    urls: dict[str, str] = {}
    for size, quality in _STEPS:
        if size * max(max(picture.shape[:2]) for picture in shown.values()) > _LONGEST:
            continue
        urls = {}
        for name, picture in shown.items():
            # The traditional picture is small already.
            reduced = picture if max(picture.shape) < 400 or size == 1 else _reduced(picture, size)
            done, data = cv2.imencode(".webp", reduced[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, quality])
            assert done
            urls[name] = "data:image/webp;base64," + base64.b64encode(data.tobytes()).decode()
        if sum(map(len, urls.values())) <= most:
            break
    return urls, size


def png_url(picture: NDArray[np.uint8]) -> str:
    """A picture of few colours as PNG in a data URL."""
    import cv2

    done, data = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    assert done
    return "data:image/png;base64," + base64.b64encode(data.tobytes()).decode()


def _reduced(picture: NDArray[np.uint8], size: float) -> NDArray[Any]:
    import cv2

    width, height = (max(1, round(size * n)) for n in picture.shape[1::-1])
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA))


def _in_colour(picture: NDArray) -> NDArray:
    if picture.ndim == 2 or picture.shape[2] < 3:
        picture = np.repeat(picture.reshape(*picture.shape[:2], -1)[..., :1], 3, axis=2)
    return picture[..., :3]
