"""Pictures and maps of a report: rendered, coloured, and encoded to be part of the page itself."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, LightFieldError

from ..data.depth_map import BINOCULAR, MODES, RARE_MODE, TELESCOPIC, DepthMap, check_depth
from ..data.rendering import Rendering
from ..rendering.render import render
from ..rendering.traditional import traditional

__all__ = [
    "ReportPictures",
    "data_urls",
    "draw_pictures",
    "encode_picture",
    "picture_url",
    "reduce_picture",
]


# Reduction and quality of WebP, in the order in which they are tried.
_SIZES = ((1.0, 92), (1.0, 78), (0.5, 85), (0.25, 85), (0.125, 80))
# Longest row that WebP holds [px], and longest side of pictures that are never reduced [px]: the
# traditional one has a pixel per lens.
_WEBP_SIDE = 16383
_SMALL = 400
# Strongest compression of PNG.
_SMALLEST = 9


@dataclass(frozen=True)
class ReportPictures:
    """Pictures of one flat, to be compared."""

    sharp: Rendering  # all in focus
    traditional: Rendering
    fixed: Mapping[
        str, Rendering
    ]  # with the median patch size of each mode, by its name, on the grid of `sharp`
    patch_size: Mapping[str, float]  # [px] of `fixed`


def draw_pictures(flat: NDArray, calibration: Calibration, depth: DepthMap) -> ReportPictures:
    """Draw a flat all in focus, traditionally, and with the median patch size of each mode."""
    check_depth(depth, calibration)
    sharp = render(flat, calibration, depth)
    sizes = {}
    for mode in (TELESCOPIC, BINOCULAR):
        found = depth.patch_size[depth.mode == mode]
        if found.size > RARE_MODE * len(depth):
            sizes[MODES[mode]] = float(np.median(found))
    fixed = {
        name: render(flat, calibration, patch_size=size, scale=sharp.scale)
        for name, size in sizes.items()
    }
    return ReportPictures(sharp, traditional(flat, calibration), fixed, sizes)


def data_urls(pictures: Mapping[str, NDArray[np.uint8]], most: int) -> tuple[dict[str, str], float]:
    """Pictures as WebP in data URLs of at most `most` characters in all, and their scale.

    All have the same quality, the best that fits, and below that the same reduction of width and
    height.
    """
    urls: dict[str, str] = {}
    for size, quality in _SIZES:
        if size * max(max(picture.shape[:2]) for picture in pictures.values()) > _WEBP_SIDE:
            continue
        urls = {}
        for name, picture in pictures.items():
            if max(picture.shape) >= _SMALL:
                picture = reduce_picture(picture, size)
            urls[name] = picture_url(picture, quality=quality)
        if sum(map(len, urls.values())) <= most:
            break
    return urls, size


def picture_url(picture: NDArray[np.uint8], suffix: str = ".webp", quality: int = 85) -> str:
    """A picture in a data URL: WebP, or PNG, for few colours; arguments as of `encode_picture`."""
    if suffix == ".png":
        quality = _SMALLEST
    content = encode_picture(picture, suffix, quality)
    return f"data:image/{suffix[1:]};base64,{base64.b64encode(content).decode()}"


def encode_picture(picture: NDArray[np.uint8], suffix: str, quality: int) -> bytes:
    """A picture (h, w) or (h, w, C), of which one or three channels are shown, as WebP or PNG.

    `quality` is that of WebP, 0 to 100, or the compression of PNG, 0 to 9 for more. LightFieldError
    if it is too large.
    """
    import cv2

    parameter = {".webp": cv2.IMWRITE_WEBP_QUALITY, ".png": cv2.IMWRITE_PNG_COMPRESSION}[suffix]
    channels = picture.reshape(*picture.shape[:2], -1)
    # OpenCV has blue first; of grey with alpha, grey is shown.
    shown = channels[..., (2, 1, 0)] if channels.shape[2] >= 3 else channels[..., 0]
    done, data = cv2.imencode(suffix, np.ascontiguousarray(shown), [parameter, quality])
    if not done:
        raise LightFieldError(
            f"{picture.shape[1]} x {picture.shape[0]} px cannot be written as {suffix[1:].upper()}"
        )
    return data.tobytes()


def reduce_picture(picture: NDArray[np.uint8], size: float) -> NDArray[np.uint8]:
    """A picture of this share of width and height."""
    import cv2

    width, height = (max(1, round(size * n)) for n in picture.shape[1::-1])
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
