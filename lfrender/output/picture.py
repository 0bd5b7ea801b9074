"""Writing pictures: the pixels as they are, and with them what is needed to lay one picture over another."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import LightFieldError
from lfcal.runtime.output_file import atomic_write, check_output

from .metadata import EmbeddedMetadata, embed_in_jpeg, embed_in_png

__all__ = ["PictureError", "check_picture", "describe", "tiff_tags", "with_alpha", "write_picture", "write_stack"]

#: Which pixel types each format holds.
_FORMATS: dict[str, tuple[str, ...]] = {
    ".exr": ("float32",),
    ".jpeg": ("uint8",),
    ".jpg": ("uint8",),
    ".png": ("uint8", "uint16"),
    ".tif": ("uint8", "uint16", "float32"),
    ".tiff": ("uint8", "uint16", "float32"),
    ".webp": ("uint8",),
}
_JPEG_QUALITY = 95
_TILE = (256, 256)
# Plain TIFF counts bytes with 32 bits; 32 MB are left for what stands beside the pixels.
_LARGEST_TIFF = 2**32 - 2**25
_NOTHING = EmbeddedMetadata()


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
    if suffix == ".exr" and find_spec("OpenEXR") is None:
        raise PictureError(f"{path}: OpenEXR pictures need the package 'OpenEXR'; pip install 'lfrender[exr]'")
    if alpha and suffix in (".jpg", ".jpeg"):
        raise PictureError(f"{path}: {suffix} cannot hold an alpha channel; use .png or .tif")


def write_picture(
    path: str | os.PathLike[str],
    picture: Any,
    *,
    alpha: bool = False,
    settings: Mapping[str, Any] | None = None,
    embedded: EmbeddedMetadata = _NOTHING,
    compress: bool = False,
) -> None:
    """Write a rendering, or plain pixels, as TIFF, PNG, JPEG, WebP or OpenEXR; the file appears whole or not at all.

    All but WebP carry a JSON text (`ImageDescription`, `Description` or comment) with the 2x3 affine from output
    pixel `(u, v)` to scene coordinates `X` and the settings of the rendering. Pixels no lens has seen are 0; with
    `alpha`, they are transparent too.

    Parameters
    ----------
    path : path-like
        The ending chooses the format.
    picture : Rendering or (h, w) or (h, w, 3) uint8, uint16 or float32
        What to write; colours in the order red, green, blue. float32 only into TIFF and OpenEXR, uint16 only into TIFF
        and PNG.
    alpha : bool
        Add the mask of valid pixels as an alpha channel (not in JPEG).
    settings : mapping, optional
        Further entries for the JSON text.
    embedded : Embedded
        Colour profile (not in OpenEXR) and EXIF data (not in TIFF and OpenEXR) to put into the file.
    compress : bool
        Write a TIFF in deflated tiles instead of plain rows: smaller, and slower to write. Above 4 GB it is a BigTIFF.

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
    text = json.dumps(describe(picture, settings))
    if alpha:
        pixels = with_alpha(pixels, np.ones(pixels.shape[:2], bool) if valid is None else np.asarray(valid))
    suffix = Path(path).suffix.lower()
    with atomic_write(path) as temporary:
        if suffix in (".tif", ".tiff"):
            _write_tiff(temporary, [(pixels, text)], embedded.icc, compress)
        elif suffix == ".exr":
            _write_exr(temporary, pixels, text)
        else:
            temporary.write_bytes(_encode(pixels, suffix, text, embedded))


def write_stack(
    path: str | os.PathLike[str],
    pictures: Sequence[Any],
    *,
    settings: Sequence[Mapping[str, Any]] | None = None,
    embedded: EmbeddedMetadata = _NOTHING,
    compress: bool = False,
) -> list[Path]:
    """Write several pictures: as pages of one TIFF, or in other formats as numbered files, `NAME_01.png` and so on.

    Parameters
    ----------
    path : path-like
        The ending chooses the format.
    pictures : sequence
        Each as for `write_picture`.
    settings : sequence of mappings, optional
        Further entries for the JSON text of each picture.
    embedded, compress
        As for `write_picture`.

    Returns
    -------
    list of Path

    Raises
    ------
    OutputError, PictureError
        As `write_picture`; also without any picture.
    """
    if not pictures:
        raise PictureError(f"{path}: a stack needs at least one picture")
    texts = settings if settings is not None else [{}] * len(pictures)
    target = Path(path)
    if target.suffix.lower() in (".tif", ".tiff"):
        pages = []
        for picture, text in zip(pictures, texts, strict=True):
            pixels = np.asarray(getattr(picture, "image", picture))
            check_picture(target, pixels.dtype)
            pages.append((pixels, json.dumps(describe(picture, text))))
        with atomic_write(target) as temporary:
            _write_tiff(temporary, pages, embedded.icc, compress)
        return [target]
    digits = max(2, len(str(len(pictures))))
    paths = [target.with_stem(f"{target.stem}_{k + 1:0{digits}d}") for k in range(len(pictures))]
    for one, picture, text in zip(paths, pictures, texts, strict=True):
        write_picture(one, picture, settings=text, embedded=embedded)
    return paths


def describe(picture: Any, settings: Mapping[str, Any] | None) -> dict[str, Any]:
    """The entries of the JSON text of a picture."""
    description: dict[str, Any] = {"software": "lfrender"}
    affine = getattr(picture, "affine", None)
    if affine is not None:
        description["affine"] = np.asarray(affine, dtype=float).tolist()
    return {**description, **(settings or {})}


def with_alpha(pixels: NDArray[Any], valid: NDArray[np.bool_]) -> NDArray[Any]:
    """`pixels` with `valid` as one more channel."""
    opaque = 1.0 if pixels.dtype.kind == "f" else np.iinfo(pixels.dtype).max
    mask = np.where(valid, opaque, 0).astype(pixels.dtype)
    return np.dstack([pixels, mask])


def _write_tiff(path: Path, pages: list[tuple[NDArray[Any], str]], icc: bytes, compress: bool) -> None:
    """Pixels and descriptions, page by page."""
    import tifffile

    with tifffile.TiffWriter(path, bigtiff=sum(pixels.nbytes for pixels, _ in pages) > _LARGEST_TIFF) as tiff:
        for pixels, text in pages:
            _write_page(tiff, pixels, text, icc, compress)


def _write_page(tiff: Any, pixels: NDArray[Any], text: str, icc: bytes, compress: bool) -> None:
    tiles: dict[str, Any] = {}
    if compress:
        tiles = {"tile": _TILE, "compression": "zlib", "compressionargs": {"level": 3}}
        tiles["predictor"] = pixels.dtype.kind != "f"
    tiff.write(np.ascontiguousarray(pixels), **tiff_tags(pixels.shape, text, icc), **tiles)


def tiff_tags(shape: tuple[int, ...], text: str, icc: bytes) -> dict[str, Any]:
    """What tifffile is to be told about a picture of this shape, with alpha where it has 2 or 4 channels."""
    channels = shape[2] if len(shape) == 3 else 1
    return {
        "photometric": "rgb" if channels >= 3 else "minisblack",
        "planarconfig": "contig" if len(shape) == 3 else None,
        "extrasamples": ["unassalpha"] if channels in (2, 4) else None,
        "description": text,
        "software": "lfrender",
        "metadata": None,
        "iccprofile": icc or None,
    }


def _encode(pixels: NDArray[Any], suffix: str, text: str, embedded: EmbeddedMetadata) -> bytes:
    import cv2

    if suffix == ".webp" and (embedded.icc or embedded.exif) and pixels.ndim == 3 and pixels.shape[2] != 2:
        return _webp(pixels, embedded)
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
    if suffix == ".png":
        return embed_in_png(data.tobytes(), text, embedded)
    return embed_in_jpeg(data.tobytes(), text, embedded) if suffix != ".webp" else bytes(data.tobytes())


def _webp(pixels: NDArray[Any], embedded: EmbeddedMetadata) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    extra = {"icc_profile": embedded.icc, "exif": embedded.exif}
    Image.fromarray(np.ascontiguousarray(pixels)).save(
        stream, "WEBP", quality=_JPEG_QUALITY, **{name: value for name, value in extra.items() if value}
    )
    return stream.getvalue()


def _write_exr(path: Path, pixels: NDArray[Any], text: str) -> None:
    import OpenEXR

    names = {2: "Y", 3: "RGB", 4: "RGBA"}
    channels = {names.get(pixels.shape[2], "Y") if pixels.ndim == 3 else "Y": np.ascontiguousarray(pixels)}
    if pixels.ndim == 3 and pixels.shape[2] == 2:
        channels = {"Y": np.ascontiguousarray(pixels[..., 0]), "A": np.ascontiguousarray(pixels[..., 1])}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "comments": text}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))
