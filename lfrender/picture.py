"""Writing pictures: the pixels as they are, and with them what is needed to lay one picture over another."""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import LightFieldError, check_output, whole_file

__all__ = ["PictureError", "check_picture", "write_picture"]

#: Which pixel types each format holds.
_FORMATS: dict[str, tuple[str, ...]] = {
    ".jpeg": ("uint8",),
    ".jpg": ("uint8",),
    ".png": ("uint8", "uint16"),
    ".tif": ("uint8", "uint16", "float32"),
    ".tiff": ("uint8", "uint16", "float32"),
    ".webp": ("uint8",),
}
_JPEG_QUALITY = 95


class PictureError(LightFieldError, ValueError):
    """A picture cannot be written in the format that was asked for."""


def check_picture(
    path: str | os.PathLike[str],
    dtype: Any = None,
    alpha: bool = False,
    inputs: Iterable[str | os.PathLike[str] | None] = (),
) -> None:
    """Refuse a picture file that could not be written, before the picture is computed.

    Parameters
    ----------
    path : path-like
        Where the picture is to go.
    dtype : dtype, optional
        Its pixel type, where already known.
    alpha : bool
        Whether it will have an alpha channel.
    inputs : iterable of path-like or None
        Files that are read for it and must not be replaced by it.

    Raises
    ------
    OutputError
        If the ending is unknown, the folder cannot be written, or `path` is one of the inputs.
    PictureError
        If the format cannot hold such pixels.
    """
    check_output(path, _FORMATS, inputs)
    suffix = Path(path).suffix.lower()
    if dtype is not None and np.dtype(dtype).name not in _FORMATS[suffix]:
        raise PictureError(f"{path}: {suffix} cannot hold {np.dtype(dtype).name} pixels; use .tif")
    if alpha and suffix in (".jpg", ".jpeg"):
        raise PictureError(f"{path}: {suffix} cannot hold an alpha channel; use .png or .tif")


def write_picture(
    path: str | os.PathLike[str],
    picture: Any,
    *,
    alpha: bool = False,
    settings: Mapping[str, Any] | None = None,
) -> None:
    """Write a rendering, or plain pixels, as TIFF, PNG, JPEG or WebP; the file appears whole or not at all.

    TIFF, PNG and JPEG carry a JSON text (`ImageDescription`, `Description` or comment) with the 2x3 affine from output
    pixel `(u, v)` to scene coordinates `X` and the settings of the rendering. Pixels no lens has seen are 0; with
    `alpha`, they are transparent too.

    Parameters
    ----------
    path : path-like
        The ending chooses the format.
    picture : Rendering or (h, w) or (h, w, 3) uint8, uint16 or float32
        What to write; colours in the order red, green, blue. float32 only into TIFF, uint16 into TIFF and PNG.
    alpha : bool
        Add the mask of valid pixels as an alpha channel (not in JPEG).
    settings : mapping, optional
        Further entries for the JSON text.

    Raises
    ------
    OutputError, PictureError
        If the file cannot be written, or its format cannot hold these pixels.
    """
    pixels = np.asarray(getattr(picture, "image", picture))
    if pixels.ndim not in (2, 3) or (pixels.ndim == 3 and pixels.shape[2] != 3) or not pixels.size:
        raise PictureError(f"{path}: a picture has shape (h, w) or (h, w, 3), got {pixels.shape}")
    check_picture(path, pixels.dtype, alpha)
    valid = getattr(picture, "valid", None)
    text = json.dumps(_describe(picture, settings))
    if alpha:
        pixels = _with_alpha(pixels, np.ones(pixels.shape[:2], bool) if valid is None else np.asarray(valid))
    suffix = Path(path).suffix.lower()
    with whole_file(path) as temporary:
        if suffix in (".tif", ".tiff"):
            _write_tiff(temporary, pixels, text)
        else:
            temporary.write_bytes(_encode(pixels, suffix, text))


def _describe(picture: Any, settings: Mapping[str, Any] | None) -> dict[str, Any]:
    description: dict[str, Any] = {"software": "lfrender"}
    affine = getattr(picture, "affine", None)
    if affine is not None:
        description["affine"] = np.asarray(affine, dtype=float).tolist()
    return {**description, **(settings or {})}


def _with_alpha(pixels: NDArray[Any], valid: NDArray[np.bool_]) -> NDArray[Any]:
    opaque = 1.0 if pixels.dtype.kind == "f" else np.iinfo(pixels.dtype).max
    mask = np.where(valid, opaque, 0).astype(pixels.dtype)
    return np.dstack([pixels, mask])


def _write_tiff(path: Path, pixels: NDArray[Any], text: str) -> None:
    import tifffile

    colour = pixels.ndim == 3 and pixels.shape[2] >= 3
    alpha = pixels.ndim == 3 and pixels.shape[2] in (2, 4)
    tifffile.imwrite(
        path,
        np.ascontiguousarray(pixels),
        photometric="rgb" if colour else "minisblack",
        planarconfig="contig" if pixels.ndim == 3 else None,
        extrasamples=["unassalpha"] if alpha else None,
        description=text,
        software="lfrender",
        metadata=None,
    )


def _encode(pixels: NDArray[Any], suffix: str, text: str) -> bytes:
    import cv2

    if pixels.ndim == 3 and pixels.shape[2] == 2:
        pixels = pixels[..., (0, 0, 0, 1)]
    if pixels.ndim == 3:
        code = cv2.COLOR_RGB2BGR if pixels.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
        pixels = cv2.cvtColor(np.ascontiguousarray(pixels), code)
    quality = {".jpg": cv2.IMWRITE_JPEG_QUALITY, ".jpeg": cv2.IMWRITE_JPEG_QUALITY, ".webp": cv2.IMWRITE_WEBP_QUALITY}
    options = [quality[suffix], _JPEG_QUALITY] if suffix in quality else []
    try:
        done, data = cv2.imencode(suffix, pixels, options)
    except cv2.error as error:
        raise PictureError(f"cannot be written as {suffix} ({error.err or error})") from error
    if not done:
        raise PictureError(f"{pixels.shape[1]} x {pixels.shape[0]} px cannot be written as {suffix}; use .tif")
    return _annotate(data.tobytes(), suffix, text.encode("ascii"))


def _annotate(data: bytes, suffix: str, text: bytes) -> bytes:
    """Put the text into the file where the format has room for one; `data` as it was elsewhere."""
    if suffix == ".png":
        after_header = 8 + 12 + 13
        body = b"tEXtDescription\0" + text
        chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
        return data[:after_header] + chunk + data[after_header:]
    if suffix in (".jpg", ".jpeg") and len(text) < 65000:
        return data[:2] + b"\xff\xfe" + struct.pack(">H", len(text) + 2) + text + data[2:]
    return data
