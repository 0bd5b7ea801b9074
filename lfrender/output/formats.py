"""The file formats of pictures: what each can hold, and how pictures are written into it.

TIFF files named `.ome.tif` and Zarr are as the microscopy community stores them (OME, NGFF 0.5):
pixels have the size of scene coordinates, so that viewers lay pictures of any scale over each
other.
"""

from __future__ import annotations

import json
import math
import secrets
import shutil
import struct
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np

from lfcal import LightFieldError
from lfcal.runtime.arrays import Array, Floats
from lfcal.runtime.output_file import check_output, output_errors
from lfcal.runtime.packages import check_package

from ..data.dense_depth import write_exr
from ..runtime.colour_profile import colour_profile
from ..runtime.types import AnyPath, Entries

__all__ = [
    "DEFAULT_QUALITY",
    "FORMATS",
    "TIFF_TILE",
    "EmbeddedMetadata",
    "Page",
    "PictureError",
    "PictureFile",
    "PictureFormat",
    "check_format",
    "check_format_package",
    "describe_pixels",
    "is_ome_name",
    "read_metadata",
    "tiff_tags",
    "tiff_tiles",
    "write_ome_zarr",
]

#: Side of the tiles of compressed TIFFs [px].
TIFF_TILE = 256
# Tags of width and height of the flat, which are not those of the picture (TIFF, EXIF).
_SIZE_TAGS = ("ImageWidth", "ImageLength", "ExifImageWidth", "ExifImageHeight")
#: Quality of JPEG and WebP if none is given: errors of two grey levels.
DEFAULT_QUALITY = 95
# Signature and first chunk (IHDR) of a PNG file [bytes]; other chunks stand behind them.
_PNG_HEAD = 33
# Exponent of light times 100,000, in the chunk gAMA of linear pictures and of those of sRGB, and
# how the chunk sRGB says that pictures are to be printed.
_LINEAR_GAMMA = 100_000
_SRGB_GAMMA = 45_455
_PERCEPTUAL = b"\0"
# Bytes of pixels that plain TIFF holds: it counts with 32 bits, and needs room for its tags.
_TIFF_BYTES = 2**32 - 2**25
# Largest sides of the chunks of OME-Zarr: all channels, one plane of a volume, 512 x 512 pixels.
_CHUNKS = {"c": 4, "t": 1, "z": 1, "y": 512, "x": 512}
# Kinds of axes that are no directions in space.
_AXES = {"c": "channel", "t": "time"}
# Levels of OME-Zarr are halved until their longer side is no longer than this [px].
_SMALLEST_LEVEL = 256

#: Pixels, with alpha where they have 2 or 4 channels, and their JSON text.
Page = tuple[Array, str]


class PictureError(LightFieldError, ValueError):
    """A picture cannot be written in the requested format.

    Examples
    --------
    >>> from lfrender.output.picture import write_stack
    >>> write_stack("stack.tif", [])
    Traceback (most recent call last):
    lfrender.output.formats.PictureError: stack.tif: a stack needs at least one picture
    """


class EmbeddedMetadata(NamedTuple):
    """ICC profile, and EXIF data without thumbnail and sizes; empty where there is none."""

    icc: bytes = b""
    exif: bytes = b""
    # Whether values are encoded by the curve of sRGB, for files without a profile; None if unknown.
    encoded: bool | None = None

    def profile(self, channels: int) -> bytes:
        """The profile of pictures of so many channels; empty where nothing is known."""
        if self.icc or self.encoded is None:
            return self.icc
        return colour_profile(channels, self.encoded)


def read_metadata(path: AnyPath) -> EmbeddedMetadata:
    """Colour profile and EXIF data of an image file; empty if there are none.

    Of TIFF only the profile is read, of damaged files nothing.
    """
    import tifffile
    from PIL import Image, JpegImagePlugin, PngImagePlugin, WebPImagePlugin
    from PIL.ExifTags import IFD, Base

    suffix = Path(path).suffix.lower()
    # The formats' own classes: Image.open refuses sensors above 179 megapixels.
    readers: Entries = {
        ".png": PngImagePlugin.PngImageFile,
        ".webp": WebPImagePlugin.WebPImageFile,
    }
    try:
        if suffix in (".tif", ".tiff"):
            with tifffile.TiffFile(path) as tiff:
                return EmbeddedMetadata(
                    bytes(tiff.pages.first.tags.valueof("InterColorProfile", b""))
                )
        with readers.get(suffix, JpegImagePlugin.JpegImageFile)(str(path)) as image:
            exif = Image.Exif()
            # Looking for EXIF data behind the pixels of a PNG file would decode them.
            if suffix != ".png" or "exif" in image.info:
                exif = image.getexif()
            for tag in (Base[name] for name in _SIZE_TAGS):
                exif.pop(tag, None)
                exif.get_ifd(IFD.Exif).pop(tag, None)
            data = exif.tobytes() if len(exif) else b""
            return EmbeddedMetadata(image.info.get("icc_profile") or b"", data)
    # Readers raise errors of any kind on damaged data; the pixels matter more.
    except Exception:
        return EmbeddedMetadata()


class PictureFile(NamedTuple):
    """What is written into a file."""

    pages: list[Page]  # of formats without stacks, one
    embedded: EmbeddedMetadata = EmbeddedMetadata()
    compress: bool = False
    quality: int = DEFAULT_QUALITY


@dataclass(frozen=True)
class PictureFormat:
    """What files with one suffix can hold, and how they are written."""

    pixel_types: tuple[str, ...]  # names in NumPy
    # Writes a file to a path; None for formats that hold no single pictures.
    picture: Callable[[Path, PictureFile], None] | None = None
    alpha: bool = True
    folder: bool = False  # whether a picture is a folder, which its writer moves into place itself
    stack: bool = False  # whether a file can hold several pictures
    tiles: bool = False  # whether it can be written tile by tile (`tiled_picture`)
    animation: str = ""  # name of the format in Pillow if it can hold an animation
    film: tuple[str, dict[str, str]] | None = (
        None  # encoder of FFmpeg and its options, if it is a film
    )
    display: bool = False  # whether values are always those of a display, encoded by sRGB
    quality: bool = False  # whether something is lost, more or less of it
    package: str = ""  # that is needed

    def reduces(self, pixel_type: str) -> bool:
        """Whether it holds 8 bits a channel in the place of pixels of this type."""
        return (
            pixel_type in _ALL
            and pixel_type not in self.pixel_types
            and "uint8" in self.pixel_types
        )


def check_format(
    path: AnyPath,
    *uses: Literal["picture", "animation", "film"],
    dtype: Any = None,
    alpha: bool = False,
    quality: int | None = None,
    inputs: Iterable[Any] = (),
) -> None:
    """Raise an OutputError or PictureError if a file could not be written.

    Its format must be for one of the `uses`, hold 8 bits or pixels of this type, have a quality
    from 1 to 100 if one is given, and have its package installed; `path` must be in a folder that
    can be written, and none of the `inputs` that are read for it.
    """
    suffixes = []
    for known, format_ in FORMATS.items():
        suffixes += [known for use in uses if getattr(format_, use)]
    check_output(path, suffixes, inputs)
    suffix = Path(path).suffix.lower()
    kind = FORMATS[suffix]
    if dtype is not None:
        name = np.dtype(dtype).name
        if name not in kind.pixel_types and not kind.reduces(name):
            raise PictureError(f"{path}: {suffix} cannot hold {name} pixels; use .tif")
    if alpha and not kind.alpha:
        raise PictureError(f"{path}: {suffix} cannot hold an alpha channel; use .png or .tif")
    check_format_package(path, kind, quality)
    if kind.film:
        import av

        encoder = kind.film[0]
        if encoder not in av.codecs_available:
            built = f"the package 'av' was built without the encoder {encoder}"
            raise PictureError(f"{path}: {built}; use another suffix")


def check_format_package(path: AnyPath, kind: PictureFormat, quality: int | None = None) -> None:
    """PictureError if a format needs a package that is not installed, or has not this quality."""
    if quality is not None and not kind.quality:
        raise PictureError(
            f"{path}: {Path(path).suffix} has no quality; leave it out, or use .jpg or .webp"
        )
    if quality is not None and not 1 <= quality <= 100:
        raise PictureError(f"{path}: quality must be from 1 to 100, got {quality!r}")
    if kind.package:
        check_package(kind.package, f"{path}: {Path(path).suffix} files need", PictureError)


def describe_pixels(pixels: Array) -> str:
    """Size and type of a picture in words, for messages and to compare pictures."""
    colour = ""
    if pixels.ndim > 2:
        colour = " in colour"
    return f"{pixels.shape[1]} x {pixels.shape[0]} px of {pixels.dtype}{colour}"


def is_ome_name(path: Path) -> bool:
    """Whether the name asks for OME metadata: `.ome.tif`, `.ome.zarr`."""
    return ".ome." in path.name.lower()


def _affine(text: str) -> Floats:
    return np.array(json.loads(text).get("affine", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.float64)


def tiff_tags(
    shape: tuple[int, ...], text: str, embedded: EmbeddedMetadata, ome: bool = False
) -> Entries:
    """Options of tifffile for a picture of this shape, with alpha where it has 2 or 4 channels."""
    channels = (*shape, 1)[2]
    about = None
    if ome:
        about = {"axes": "YXS"[: len(shape)], "Description": text}
        for axis, size in zip("XY", np.diag(_affine(text)), strict=True):
            about |= {f"PhysicalSize{axis}": size, f"PhysicalSize{axis}Unit": "pixel"}
    return {
        "photometric": "rgb" if channels >= 3 else "minisblack",
        "planarconfig": "contig" if len(shape) == 3 else None,
        "extrasamples": ["unassalpha"] if channels in (2, 4) else None,
        "description": None if ome else text,
        "software": "lfrender",
        "metadata": about,
        "iccprofile": embedded.profile(channels) or None,
    }


def tiff_tiles(dtype: Any) -> Entries:
    """Options of tifffile for deflated tiles."""
    return {
        "tile": (TIFF_TILE, TIFF_TILE),
        "compression": "zlib",
        "compressionargs": {"level": 3},
        "predictor": np.dtype(dtype).kind != "f",
    }


def _write_tiff(path: Path, file: PictureFile) -> None:
    import tifffile

    big = sum(pixels.nbytes for pixels, _ in file.pages) > _TIFF_BYTES
    ome = is_ome_name(path)
    with tifffile.TiffWriter(path, bigtiff=big, ome=ome) as tiff:
        for pixels, text in file.pages:
            options = tiff_tags(pixels.shape, text, file.embedded, ome)
            if file.compress:
                options |= tiff_tiles(pixels.dtype)
            tiff.write(np.ascontiguousarray(pixels), **options)


def _write_exr(path: Path, file: PictureFile) -> None:
    ((pixels, text),) = file.pages
    count = (*pixels.shape, 1)[2]
    # The library writes three or four layers of one name as R, G, B and A.
    channels = {"RGBA"[:count]: pixels}
    if count < 3:
        layers = np.atleast_3d(pixels)
        channels = {name: layers[..., k] for k, name in enumerate("YA"[:count])}
    write_exr(path, channels, text)


def _write_png(path: Path, file: PictureFile) -> None:
    # By imagecodecs: Pillow has no colours of 16 bits.
    from imagecodecs import PNG, PngError, png_encode

    ((pixels, text),) = file.pages
    embedded = file.embedded
    pixels = np.ascontiguousarray(pixels)
    try:
        # Neighbours differ little; runs of equal differences are found fast.
        data = png_encode(pixels, level=1, strategy=PNG.STRATEGY.RLE, filter=PNG.FILTER.SUB)
    except (PngError, ValueError) as error:
        raise PictureError(f"{path}: cannot be written as .png ({error})") from error
    chunks = [(b"tEXt", b"Description\0" + text.encode("ascii"))]
    if embedded.icc:
        chunks.append((b"iCCP", b"ICC profile\0\0" + zlib.compress(embedded.icc)))
    elif embedded.encoded is not None:
        gamma = _LINEAR_GAMMA
        if embedded.encoded:
            gamma = _SRGB_GAMMA
            chunks.append((b"sRGB", _PERCEPTUAL))
        chunks.append((b"gAMA", struct.pack(">I", gamma)))
    if embedded.exif:
        chunks.append((b"eXIf", embedded.exif.removeprefix(b"Exif\0\0")))
    further = b"".join(_png_chunk(kind, body) for kind, body in chunks)
    path.write_bytes(data[:_PNG_HEAD] + further + data[_PNG_HEAD:])


def _png_chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def _write_small(path: Path, file: PictureFile) -> None:
    """JPEG or WebP."""
    from PIL import Image

    ((pixels, text),) = file.pages
    embedded = file.embedded
    more: Entries = {"quality": file.quality}
    # Without a profile, programs take JPEG and WebP for sRGB.
    if embedded.icc or embedded.encoded is False:
        more["icc_profile"] = embedded.profile((*pixels.shape, 1)[2])
    if embedded.exif:
        more["exif"] = embedded.exif
    if path.suffix.lower() != ".webp":
        more["comment"] = text.encode("ascii")
    if pixels.shape[2:] == (2,):
        # Grey with alpha as colours with alpha.
        pixels = pixels[..., (0, 0, 0, 1)]
    try:
        Image.fromarray(np.ascontiguousarray(pixels)).save(path, **more)
    except (OSError, ValueError) as error:
        size = f"{pixels.shape[1]} x {pixels.shape[0]} px"
        raise PictureError(
            f"{path}: {size} cannot be written as {path.suffix} ({error}); use .tif"
        ) from error


def _write_zarr_picture(path: Path, file: PictureFile) -> None:
    """An OME-Zarr group with the array `0`, (c, y, x) or (y, x)."""
    ((pixels, text),) = file.pages
    affine = _affine(text)
    scale = np.diag(affine)[::-1].tolist()
    first = affine[::-1, 2].tolist()
    if pixels.ndim == 2:
        write_ome_zarr(path, pixels, "yx", scale, first, text)
    else:
        layers = np.moveaxis(pixels, 2, 0)
        write_ome_zarr(path, layers, "cyx", [1.0, *scale], [0.0, *first], text)


def write_ome_zarr(
    path: Path,
    array: Array,
    axes: str,
    scale: list[float],
    first: list[float],
    text: str,
    units: Mapping[str, str] = MappingProxyType({}),
    levels: bool = False,
) -> None:
    """Write an array as array `0` of an OME-Zarr group (NGFF 0.5), whole or not at all.

    `axes` has a letter for each axis, the last two `yx`; `scale` and `first` are distance and place
    of its values along each, in `units` where they have one; `text` is stored as the description.
    With `levels`, arrays `1`, `2`, ... have half of the rows and columns each.
    """
    import zarr

    named: list[Entries] = []
    for name in axes:
        named.append({"name": name, "type": _AXES.get(name, "space")})
        if name in units:
            named[-1]["unit"] = units[name]
    count = 1
    if levels:
        count += max(0, math.ceil(math.log2(max(array.shape[-2:]) / _SMALLEST_LEVEL)))
    datasets = []
    for level in range(count):
        wide = np.array([*[1] * (len(axes) - 2), 2**level, 2**level])
        place = first + (wide - 1) / 2 * scale
        moves = [
            {"type": "scale", "scale": (wide * scale).tolist()},
            {"type": "translation", "translation": place.tolist()},
        ]
        datasets.append({"path": f"{level}", "coordinateTransformations": moves})
    scales = [{"name": path.name, "axes": named, "datasets": datasets}]
    attributes = {"ome": {"version": "0.5", "multiscales": scales}, "description": text}
    made = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        with output_errors(path), zarr.config.set({"array.write_empty_chunks": True}):
            group = zarr.create_group(str(made), attributes=attributes, zarr_format=3)
            for level in range(count):
                data = np.ascontiguousarray(array)
                sides = zip(axes, data.shape, strict=True)
                chunks = tuple(min(length, _CHUNKS[name]) for name, length in sides)
                group.create_array(f"{level}", data=data, chunks=chunks, dimension_names=list(axes))
                if level + 1 < count:
                    array = _halve(array)
            made.replace(path)
    finally:
        shutil.rmtree(made, ignore_errors=True)


def _halve(array: Array) -> Array:
    """Means of squares of 2 x 2 values along the last two axes, without an odd row or column."""
    even = array[..., : array.shape[-2] // 2 * 2, : array.shape[-1] // 2 * 2]
    rows = (even[..., ::2, :] + even[..., 1::2, :]) / 2
    return np.asarray((rows[..., ::2] + rows[..., 1::2]) / 2)


_WHOLE = ("uint8", "uint16")
_ALL = ("uint8", "uint16", "float32")
_TIFF = PictureFormat(_ALL, _write_tiff, stack=True, tiles=True)
_JPEG = PictureFormat(("uint8",), _write_small, alpha=False, display=True, quality=True)


def _film(
    pixel_types: tuple[str, ...],
    encoder: str,
    options: dict[str, str] | None = None,
    display: bool = True,
) -> PictureFormat:
    film = (encoder, options or {})
    return PictureFormat(pixel_types, film=film, display=display, package="av")


#: The formats by the suffix of their files.
FORMATS = {
    ".exr": PictureFormat(("float32",), _write_exr, package="OpenEXR"),
    ".gif": PictureFormat(("uint8",), animation="GIF", display=True),
    ".jpeg": _JPEG,
    ".jpg": _JPEG,
    # FFV1 loses nothing; every picture stands for itself and has a checksum.
    ".mkv": _film(_WHOLE, "ffv1", {"level": "3", "g": "1", "slicecrc": "1"}, False),
    # ProRes 422 HQ, which programs for cutting films take.
    ".mov": _film(_WHOLE, "prores_ks", {"profile": "3", "vendor": "apl0"}),
    # H.264 plays everywhere. The eye sees no difference at this rate factor (crf), and hardly any
    # at twice that.
    ".mp4": _film(("uint8",), "libx264", {"crf": "10", "preset": "fast"}),
    ".png": PictureFormat(_WHOLE, _write_png, animation="PNG"),
    ".tif": _TIFF,
    ".tiff": _TIFF,
    ".webp": replace(_JPEG, alpha=True, animation="WEBP"),
    # Raw planes, by default 4:2:0 of 10 bits, as coders of video take them.
    ".yuv": _film(_WHOLE, "rawvideo"),
    ".zarr": PictureFormat(_ALL, _write_zarr_picture, folder=True, tiles=True, package="zarr"),
}
