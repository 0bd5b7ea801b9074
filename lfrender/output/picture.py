"""Picture files: pixels, and the affine that lays one picture over another."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.runtime.arrays import Array, Booleans, Floats, white_of
from lfcal.runtime.errors import check_type
from lfcal.runtime.light.tone import Exposure, WhiteBalance
from lfcal.runtime.output_file import atomic_write, refuse_leftovers

from ..data.rendering import Rendering
from ..runtime.choices import Tone
from ..runtime.colour_profile import is_linear_profile
from ..runtime.types import AnyPath, Entries
from .finish import Finish
from .formats import (
    DEFAULT_QUALITY,
    FORMATS,
    EmbeddedMetadata,
    PictureError,
    PictureFile,
    check_format,
)

__all__ = [
    "PictureError",
    "describe",
    "encoded_by",
    "with_alpha",
    "write_finished",
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
    tone: Tone = "auto",
    white_balance: WhiteBalance = "auto",
    quality: int | None = None,
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
        Colours in the order red, green, blue. What a format cannot hold is written with 8 bits:
        float32 into all but TIFF, OpenEXR and Zarr, uint16 into JPEG and WebP.
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
        Brighten a rendering by one gain on its light, which the JSON text names; `"auto"` does so
        to a dim one by its brightest places. The default is `"auto"` for linear pictures as JPEG
        and WebP, which are made to be looked at, and none for all others.
    tone : {"auto", "linear", "srgb"}
        Whether values are in proportion to light, or encoded by the curve of sRGB. `"auto"` encodes
        linear pictures (of more than 8 bits, where the camera does not tell otherwise) as JPEG and
        WebP and where they get 8 bits, and keeps all others as they are. PNG and TIFF say which.
    white_balance : {"auto", "none"} or (float, float, float)
        Gains on the light of red, green and blue. `"auto"` changes renderings from a colour filter
        mosaic alone: by the white image of the camera, or else until they are grey on the average.
    quality : int, optional
        Of JPEG and WebP, from 1 to 100: more has less error and larger files. The default is 95.

    Examples
    --------
    >>> import tempfile, numpy, lfcal, lfrender
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     lfrender.write_picture(f"{folder}/grey.png", numpy.full((20, 30), 7, numpy.uint8))
    ...     lfcal.read_flat(f"{folder}/grey.png").shape
    (20, 30)
    """
    finish = Finish(
        path, exposure, tone, white_balance, quality=quality, encoded=encoded_by(embedded)
    )
    stored: Entries = {"settings": settings, "embedded": embedded, "compress": compress}
    write_finished(path, picture, finish, alpha=alpha, **stored)


def write_finished(
    path: AnyPath,
    picture: Any,
    finish: Finish,
    *,
    alpha: bool = False,
    settings: Mapping[str, Any] | None = None,
    embedded: EmbeddedMetadata = _NO_METADATA,
    compress: bool = False,
) -> None:
    """Write a picture after `finish`, which several pictures may share; else as `write_picture`."""
    file = _file(path, picture, settings, finish, embedded, alpha)
    _write(Path(path), file._replace(compress=compress))


def write_stack(
    path: AnyPath,
    pictures: Sequence[Any],
    *,
    settings: Sequence[Mapping[str, Any]] | None = None,
    embedded: EmbeddedMetadata = _NO_METADATA,
    finish: Finish | None = None,
) -> list[Path]:
    """Write pictures as pages of one TIFF, in other formats as files `NAME_01.png`, ...

    `settings` are further entries for the JSON text of each; `finish` is what is done to all, by
    default as `write_picture` does; the rest is as there.
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
    finish = finish or Finish(target, encoded=encoded_by(embedded))
    finish = finish.measured(pictures[0])
    several = zip(pictures, settings or [{}] * len(pictures), strict=True)
    files = [_file(target, picture, entries, finish, embedded) for picture, entries in several]
    if FORMATS[target.suffix.lower()].stack:
        pages = [page for file in files for page in file.pages]
        _write(target, files[0]._replace(pages=pages))
        return [target]
    paths = [target.with_stem(f"{target.stem}_{k + 1:0{digits}d}") for k in range(len(pictures))]
    numbered = rf"{re.escape(target.stem)}_\d{{2,}}{re.escape(target.suffix)}"
    refuse_leftovers(target.parent, numbered, [path.name for path in paths])
    for one, file in zip(paths, files, strict=True):
        _write(one, file)
    return paths


def describe(affine: Floats | None, settings: Mapping[str, Any] | None) -> str:
    """The JSON text of a picture."""
    entries: Entries = {"software": "lfrender"}
    if affine is not None:
        entries["affine"] = affine.tolist()
    return json.dumps(entries | dict(settings or {}))


def with_alpha(pixels: Array, valid: Booleans) -> Array:
    """`pixels` with `valid` as one more channel."""
    opaque = np.asarray(white_of(pixels), pixels.dtype)
    return np.dstack([pixels, opaque * np.broadcast_to(valid, pixels.shape[:2])])


def encoded_by(embedded: EmbeddedMetadata) -> bool | None:
    """Whether a profile says that values are encoded; None without a profile."""
    if not embedded.icc:
        return None
    return not is_linear_profile(embedded.icc)


def _file(
    path: AnyPath,
    picture: Any,
    settings: Mapping[str, Any] | None,
    finish: Finish,
    embedded: EmbeddedMetadata,
    alpha: bool = False,
) -> PictureFile:
    """What is written of a picture, if the format of `path` can hold it."""
    if np.ma.is_masked(picture):
        raise PictureError(f"{path}: a picture has no masked pixels; fill them in first")
    seen: Any = True
    affine = None
    embedded = embedded._replace(encoded=None)
    if isinstance(picture, Rendering):
        finish = finish.measured(picture)
        shown = finish.apply(picture)
        pixels = shown.image
        seen = shown.valid
        affine = shown.affine
        settings = {**(settings or {}), **finish.entries(shown)}
        embedded = embedded._replace(encoded=shown.encoded)
        if shown.encoded != finish.is_encoded(picture):
            # The profile of the flat describes other values.
            embedded = embedded._replace(icc=b"")
    else:
        pixels = finish.apply_to_pixels(np.asarray(picture))
    if pixels.shape[2:] not in ((), (3,)) or pixels.ndim < 2 or not pixels.size:
        raise PictureError(f"{path}: a picture has shape (h, w) or (h, w, 3), got {pixels.shape}")
    check_format(path, "picture", dtype=pixels.dtype, alpha=alpha, quality=finish.quality)
    if alpha:
        pixels = with_alpha(pixels, np.asarray(seen))
    page = (pixels, describe(affine, settings))
    return PictureFile([page], embedded, quality=finish.quality or DEFAULT_QUALITY)


def _write(path: Path, file: PictureFile) -> None:
    kind = FORMATS[path.suffix.lower()]
    assert kind.picture is not None
    # Folders are moved into place by their writer.
    with nullcontext(path) if kind.folder else atomic_write(path) as temporary:
        kind.picture(temporary, file)
