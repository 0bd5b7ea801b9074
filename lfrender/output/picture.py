"""Picture files: pixels, and the affine that lays one picture over another."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.runtime.arrays import (
    Array,
    Booleans,
    Exposure,
    Floats,
    brighten,
    exposure_gain,
    to_eight_bits,
    white_of,
)
from lfcal.runtime.errors import check_type
from lfcal.runtime.output_file import atomic_write, refuse_leftovers

from ..data.rendering import Rendering
from ..runtime.types import AnyPath
from .formats import FORMATS, EmbeddedMetadata, Page, PictureError, check_format

__all__ = [
    "Brightness",
    "PictureError",
    "default_exposure",
    "describe",
    "eight_bits",
    "needs_eight_bits",
    "with_alpha",
    "write_picture",
    "write_stack",
]

_NO_METADATA = EmbeddedMetadata()


def write_picture(
    path: AnyPath,
    picture: Any,
    *,
    alpha: bool = False,
    settings: Mapping[str, Any] | None = None,
    embedded: EmbeddedMetadata = _NO_METADATA,
    compress: bool = False,
    exposure: Exposure | None = None,
) -> None:
    """Write a rendering, or plain pixels, as TIFF, PNG, JPEG, WebP, OpenEXR or OME-Zarr.

    The file appears whole or not at all.

    All but WebP carry a JSON text (`ImageDescription`, `Description` or comment) with the 2x3
    affine from output pixel `(u, v)` to scene coordinates `X` and the settings. OutputError or
    PictureError if the file cannot be written, or its format cannot hold these pixels.

    Parameters
    ----------
    path : path-like
        The suffix chooses the format; `.ome.tif` is a TIFF with OME metadata.
    picture : Rendering or (h, w) or (h, w, 3) uint8, uint16 or float32
        Colours in the order red, green, blue. What a format cannot hold is written with 8 bits, in
        proportion: float32 into all but TIFF, OpenEXR and Zarr, uint16 into JPEG and WebP; see
        `eight_bits`.
    alpha : bool
        Make pixels that no lens has seen transparent (not in JPEG); they are 0 in any case.
    settings : mapping, optional
        Further entries for the JSON text.
    embedded : EmbeddedMetadata
        Colour profile (not in OpenEXR) and EXIF data (not in TIFF and OpenEXR) to put into the
        file.
    compress : bool
        Write a TIFF in deflated tiles instead of plain rows: smaller, and slower to write. Above 4
        GB it is a BigTIFF.
    exposure : float or "auto", optional [EV]
        Brighten a rendering by one gain, which the JSON text names; `"auto"` does so to a dim one
        of more than 8 bits, by its brightest places. The default is `"auto"` for JPEG and WebP,
        which are made to be looked at, and none for all others.

    Examples
    --------
    >>> import tempfile, numpy, lfcal, lfrender
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     lfrender.write_picture(f"{folder}/grey.png", numpy.full((20, 30), 7, numpy.uint8))
    ...     lfcal.read_flat(f"{folder}/grey.png").shape
    (20, 30)
    """
    brightness = Brightness(default_exposure(path) if exposure is None else exposure)
    _write(Path(path), [_page(path, picture, settings, brightness, alpha)], embedded, compress)


def write_stack(
    path: AnyPath,
    pictures: Sequence[Any],
    *,
    settings: Sequence[Mapping[str, Any]] | None = None,
    embedded: EmbeddedMetadata = _NO_METADATA,
) -> list[Path]:
    """Write pictures as pages of one TIFF, in other formats as files `NAME_01.png`, ...

    `settings` are further entries for the JSON text of each; the rest is as for `write_picture`.
    OutputError if numbered files of a longer stack are there already.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> stack = lfrender.focal_stack(flat, camera, [-7.0, 7.0], scale=6)
    >>> with TemporaryDirectory() as folder:
    ...     [path.name for path in write_stack(f"{folder}/stack.tif", stack)]
    ['stack.tif']
    """
    check_type(pictures, Sequence, "pictures", "give a list of pictures")
    if not pictures:
        raise PictureError(f"{path}: a stack needs at least one picture")
    target = Path(path)
    digits = max(2, len(str(len(pictures))))
    brightness = Brightness(default_exposure(target))
    several = zip(pictures, settings or [{}] * len(pictures), strict=True)
    pages = [_page(target, picture, entries, brightness) for picture, entries in several]
    if FORMATS[target.suffix.lower()].stack:
        _write(target, pages, embedded)
        return [target]
    paths = [target.with_stem(f"{target.stem}_{k + 1:0{digits}d}") for k in range(len(pictures))]
    numbered = rf"{re.escape(target.stem)}_\d{{2,}}{re.escape(target.suffix)}"
    refuse_leftovers(target.parent, numbered, [path.name for path in paths])
    for one, page in zip(paths, pages, strict=True):
        _write(one, [page], embedded)
    return paths


def needs_eight_bits(path: AnyPath, picture: Any) -> bool:
    """Whether the format of `path` holds 8 bits a channel, but not the pixels of a picture."""
    kind = FORMATS.get(Path(path).suffix.lower())
    return kind is not None and kind.reduces(
        np.asarray(getattr(picture, "image", picture)).dtype.name
    )


def eight_bits(picture: Any) -> Any:
    """A rendering, or plain pixels, with 8 bits per channel, without a tone curve.

    0 to white become 0 to 255.

    White is that of the rendering, else the largest value of the type, and 1 of floats.
    """
    if not isinstance(picture, Rendering):
        return to_eight_bits(np.asarray(picture))
    return replace(picture, image=to_eight_bits(picture.image, picture.white), white=None)


class Brightness:
    """One gain for all pictures of a result, found on the first one.

    `exposure` is in EV, `"auto"`, or None for no gain.
    """

    def __init__(self, exposure: Exposure | None = None, gain: float = 1.0) -> None:
        self._exposure, self.gain = exposure, gain

    def apply(self, picture: Rendering) -> Rendering:
        """A picture with the gain, in its type."""
        if self._exposure is not None:
            self.gain = exposure_gain(picture.image, picture.white, self._exposure)
            self._exposure = None
        return replace(picture, image=brighten(picture.image, self.gain, picture.white))

    @property
    def entries(self) -> dict[str, float]:
        """What a file says of it."""
        if self.gain == 1:
            return {}
        return {"exposure_gain": self.gain}


def default_exposure(path: AnyPath) -> Exposure | None:
    """`"auto"` for formats that are made to be looked at, None (no gain) for all others."""
    if Path(path).suffix.lower() in (".jpg", ".jpeg", ".webp", ".gif", ".mp4"):
        return "auto"
    return None


def describe(affine: Floats | None, settings: Mapping[str, Any] | None) -> str:
    """The JSON text of a picture."""
    entries: dict[str, Any] = {"software": "lfrender"}
    if affine is not None:
        entries["affine"] = affine.tolist()
    return json.dumps(entries | dict(settings or {}))


def with_alpha(pixels: Array, valid: Booleans) -> Array:
    """`pixels` with `valid` as one more channel."""
    opaque = np.asarray(white_of(pixels), pixels.dtype)
    return np.dstack([pixels, opaque * np.broadcast_to(valid, pixels.shape[:2])])


def _page(
    path: AnyPath,
    picture: Any,
    settings: Mapping[str, Any] | None,
    brightness: Brightness,
    alpha: bool = False,
) -> Page:
    """Pixels and JSON text of a picture, if the format of `path` can hold them."""
    if isinstance(picture, Rendering):
        picture = brightness.apply(picture)
        settings = {**(settings or {}), **brightness.entries}
    if needs_eight_bits(path, picture):
        picture = eight_bits(picture)
    pixels = np.asarray(getattr(picture, "image", picture))
    if pixels.shape[2:] not in ((), (3,)) or pixels.ndim < 2 or not pixels.size:
        raise PictureError(f"{path}: a picture has shape (h, w) or (h, w, 3), got {pixels.shape}")
    check_format(path, "picture", dtype=pixels.dtype, alpha=alpha)
    if alpha:
        pixels = with_alpha(pixels, np.asarray(getattr(picture, "valid", True)))
    return pixels, describe(getattr(picture, "affine", None), settings)


def _write(
    path: Path, pages: list[Page], embedded: EmbeddedMetadata, compress: bool = False
) -> None:
    kind = FORMATS[path.suffix.lower()]
    assert kind.picture is not None
    # Folders are moved into place by their writer.
    with nullcontext(path) if kind.folder else atomic_write(path) as temporary:
        kind.picture(temporary, pages, embedded, compress)
