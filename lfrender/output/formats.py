"""The file formats of pictures, registered once: what each can hold, and how pictures are written into it.

To add a format, add an entry to `FORMATS`: pictures, stacks, tiles, animations, films and the command line take from
there which formats they can write.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lfcal import LightFieldError
from lfcal.runtime.output_file import check_output

from .metadata import EmbeddedMetadata, embed_in_png
from .ome import is_ome_name, ome_tags, write_ome_zarr

__all__ = [
    "FORMATS", "Page", "PictureError", "PictureFormat", "check_format", "check_package", "tiff_tags", "tiff_tiles",
    "write_exr",
]  # fmt: skip

#: Pixels, with alpha where they have 2 or 4 channels, and the JSON text that is stored with them.
Page = tuple[NDArray[Any], str]


class PictureError(LightFieldError, ValueError):
    """A picture cannot be written in the requested format.

    Examples
    --------
    >>> from lfrender.output.picture import write_stack
    >>> write_stack("stack.tif", [])
    Traceback (most recent call last):
    lfrender.output.formats.PictureError: stack.tif: a stack needs at least one picture
    """


@dataclass(frozen=True)
class PictureFormat:
    """What files with one suffix can hold, and how they are written."""

    #: NumPy names of the pixel types.
    pixel_types: tuple[str, ...]
    #: `picture(path, pages, embedded, compress)` writes a picture; None for formats that hold no single pictures.
    picture: Callable[[Path, list[Page], EmbeddedMetadata, bool], None] | None = None
    alpha: bool = True
    folder: bool = False  # whether a picture is a folder, which its writer moves into place itself
    stack: bool = False  # whether a file can hold several pictures
    tiles: bool = False  # whether it can be written tile by tile (`tiled_picture`)
    animation: str = ""  # name of the format in Pillow if it can hold an animation
    film: tuple[str, dict[str, str]] | None = None  # encoder of FFmpeg and its options, if it is a film
    package: str = ""  # that is needed ...
    extra: str = ""  # ... and the extra of lfrender that installs it

    def reduces(self, pixel_type: str | None) -> bool:
        """Whether it holds 8 bits a channel in the place of pixels of this type."""
        return (
            pixel_type in ("uint16", "float32") and pixel_type not in self.pixel_types and "uint8" in self.pixel_types
        )


def check_format(
    path: str | os.PathLike[str],
    *uses: Literal["picture", "animation", "film"],
    dtype: Any = None,
    alpha: bool = False,
    inputs: Iterable[Any] = (),
) -> None:
    """Raise an error if a file could not be written, before anything is computed for it.

    OutputError if no format with one of these uses has such a suffix, the folder cannot be written, or `path` is one of
    the `inputs` that are read for it. PictureError if the format can hold neither pixels of this type nor 8 bits, or no
    alpha channel, or needs a package or an encoder that is not installed.
    """
    check_output(path, [name for name, kind in FORMATS.items() if any(getattr(kind, use) for use in uses)], inputs)
    suffix = Path(path).suffix.lower()
    kind = FORMATS[suffix]
    name = None if dtype is None else np.dtype(dtype).name
    if name not in (None, *kind.pixel_types) and not kind.reduces(name):
        raise PictureError(f"{path}: {suffix} cannot hold {name} pixels; use .tif")
    check_package(path, kind)
    if alpha and not kind.alpha:
        raise PictureError(f"{path}: {suffix} cannot hold an alpha channel; use .png or .tif")
    if kind.film:
        import av

        if kind.film[0] not in av.codecs_available:
            raise PictureError(
                f"{path}: the package 'av' was built without the encoder {kind.film[0]}; use another suffix"
            )


def check_package(path: str | os.PathLike[str], kind: PictureFormat) -> None:
    """Raise PictureError if the package that a format needs is not installed."""
    if kind.package and find_spec(kind.package) is None:
        needs = f"{Path(path).suffix} files need the package '{kind.package}'"
        raise PictureError(f"{path}: {needs}; pip install 'lfrender[{kind.extra}]'")


def tiff_tags(shape: tuple[int, ...], text: str, icc: bytes) -> dict[str, Any]:
    """Options of tifffile for a picture of this shape, with alpha where it has 2 or 4 channels."""
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


def tiff_tiles(dtype: Any, side: int = 256) -> dict[str, Any]:
    """Options of tifffile for deflated tiles of `side` x `side` pixels."""
    return {
        "tile": (side, side), "compression": "zlib", "compressionargs": {"level": 3},
        "predictor": np.dtype(dtype).kind != "f",
    }  # fmt: skip


def _write_tiff(path: Path, pages: list[Page], embedded: EmbeddedMetadata, compress: bool) -> None:
    import tifffile

    # Plain TIFF counts bytes with 32 bits; 32 MB are left for what stands beside the pixels.
    big = sum(pixels.nbytes for pixels, _ in pages) > 2**32 - 2**25
    ome = is_ome_name(path)
    with tifffile.TiffWriter(path, bigtiff=big, ome=ome) as tiff:
        for pixels, text in pages:
            options = tiff_tags(pixels.shape, text, embedded.icc) | (tiff_tiles(pixels.dtype) if compress else {})
            options |= ome_tags(pixels.shape, text) if ome else {}
            tiff.write(np.ascontiguousarray(pixels), **options)


def write_exr(path: Path, channels: dict[str, NDArray[np.float32]], text: str = "") -> None:
    """Write channels (h, w), or (h, w, 3 or 4) as RGB or RGBA, as OpenEXR with a comment."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "comments": text}
    whole = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    with OpenEXR.File(header, whole) as file:
        file.write(str(path))


def _write_exr(path: Path, pages: list[Page], _embedded: EmbeddedMetadata, _compress: bool) -> None:
    ((pixels, text),) = pages
    count = pixels.shape[2] if pixels.ndim == 3 else 1
    if count < 3:
        layers = np.atleast_3d(pixels)
        channels = {name: layers[..., k] for k, name in enumerate("YA"[:count])}
    else:
        channels = {"RGBA"[:count]: pixels}
    write_exr(path, channels, text)


def _write_png(path: Path, pages: list[Page], embedded: EmbeddedMetadata, _compress: bool) -> None:
    # By OpenCV: Pillow has no colours of 16 bits.
    import cv2

    ((pixels, text),) = pages
    if pixels.ndim == 3:
        colours = pixels[..., (0, 0, 0, 1)] if pixels.shape[2] == 2 else pixels
        code = cv2.COLOR_RGB2BGR if colours.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
        pixels = cv2.cvtColor(np.ascontiguousarray(colours), code)
    try:
        data = cv2.imencode(".png", pixels)[1].tobytes()
    except cv2.error as error:
        raise PictureError(f"{path}: cannot be written as .png ({error.err or error})") from error
    path.write_bytes(embed_in_png(data, text, embedded))


def _write_small(path: Path, pages: list[Page], embedded: EmbeddedMetadata, _compress: bool) -> None:
    """JPEG or WebP."""
    from PIL import Image

    ((pixels, text),) = pages
    if pixels.ndim == 3 and pixels.shape[2] == 2:
        pixels = pixels[..., (0, 0, 0, 1)]
    kind = "WEBP" if path.suffix.lower() == ".webp" else "JPEG"
    more: dict[str, Any] = {"icc_profile": embedded.icc, "exif": embedded.exif}
    more["comment"] = text.encode("ascii") if kind == "JPEG" else None
    stream = io.BytesIO()
    try:
        given = {name: value for name, value in more.items() if value}
        Image.fromarray(np.ascontiguousarray(pixels)).save(stream, kind, quality=95, **given)
    except (OSError, ValueError) as error:
        size = f"{pixels.shape[1]} x {pixels.shape[0]} px"
        raise PictureError(f"{path}: {size} cannot be written as {path.suffix} ({error}); use .tif") from error
    path.write_bytes(stream.getvalue())


_WHOLE = ("uint8", "uint16")
_TIFF = PictureFormat((*_WHOLE, "float32"), _write_tiff, stack=True, tiles=True)
_JPEG = PictureFormat(("uint8",), _write_small, alpha=False)
#: The formats by the suffix of their files.
FORMATS = {
    ".exr": PictureFormat(("float32",), _write_exr, package="OpenEXR", extra="exr"),
    ".gif": PictureFormat(_WHOLE, animation="GIF"),
    ".jpeg": _JPEG,
    ".jpg": _JPEG,
    # FFV1 loses nothing; every picture stands for itself and has a checksum.
    ".mkv": PictureFormat(
        _WHOLE, film=("ffv1", {"level": "3", "g": "1", "slicecrc": "1"}), package="av", extra="video"
    ),
    # H.264 plays everywhere. The eye sees no difference at this rate factor (crf), and hardly any at twice that.
    ".mp4": PictureFormat(("uint8",), film=("libx264", {"crf": "10", "preset": "fast"}), package="av", extra="video"),
    ".png": PictureFormat(_WHOLE, _write_png, animation="PNG"),
    ".tif": _TIFF,
    ".tiff": _TIFF,
    ".webp": PictureFormat(("uint8",), _write_small, animation="WEBP"),
    # Raw planes, by default 4:2:0 of 10 bits, as coders of video take them.
    ".yuv": PictureFormat(_WHOLE, film=("rawvideo", {}), package="av", extra="video"),
    ".zarr": PictureFormat((*_WHOLE, "float32"), write_ome_zarr, folder=True, tiles=True, package="zarr", extra="zarr"),
}
