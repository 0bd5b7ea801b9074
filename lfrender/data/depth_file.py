"""Files of depth maps: `.npz` with the arrays of the fields, and others for other programs."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from zipfile import ZipFile

import numpy as np

from lfcal import LensBlur, LightFieldError
from lfcal.runtime.arrays import Array, Singles, digest_arrays
from lfcal.runtime.input_file import open_regular
from lfcal.runtime.output_file import atomic_write

from ..runtime.messages import one_line
from ..runtime.types import AnyPath, Entries, Size
from .frame_state import FrameState, LocalMatch
from .surface import Surface

if TYPE_CHECKING:
    from .depth_map import DepthMap

__all__ = [
    "LARGEST_RATIO",
    "SMALL",
    "DepthFileError",
    "camera_digest",
    "check_columns",
    "check_extent",
    "read_depth",
    "write_depth",
]

# Version of the files; version 1 had the lenses of some arrays in another order.
_VERSION = 2
# Limits for files that somebody has compressed: unpacked bytes over those of the file, and unpacked
# bytes that are always accepted.
LARGEST_RATIO = 50
SMALL = 1 << 26
# Arrays and numbers of a file that bear the name of their field; derived ones are for other
# programs, and those of the third row may be unknown.
_SAVED = (
    *("patch_size", "standard_error", "confidence", "reason", "pitch", "image_size", "preset"),
    *("mode", "magnification", "filled"),
    *(_OPTIONAL := ("flat_samples", "centres", "camera")),
)
# [pitch] by which the grid of a surface may end before the border of the flat, or beyond it; its
# spacing, where that is larger.
_BORDER = 2
# A surface has the wrong sign if it differs from its negated patch sizes by this share of what it
# differs from them. On seven captures right ones have at least 30, negated ones at most 0.033.
_NEGATED = 0.2


class _Column(NamedTuple):
    """An array or a number of a file."""

    kinds: str  # of `dtype.kind`
    axes: str = ""  # equal letters are equal lengths, digits are lengths
    least: float = -np.inf
    most: float = np.inf  # of texts the length
    gaps: bool = False  # whether NaN is allowed


_NUMBERS = _Column("fiu", "n", gaps=True)
_FLAGS = _Column("b", "n")
_TEXT = _Column("U", most=1e6)
_PLACES = (-1e9, 1e9)
_SCHEMA = {
    "pitch": _Column("fiu", "", 1, 1e9),
    "image_size": _Column("iu", "2", 1, 1e9),
    "patch_size": _NUMBERS,
    "standard_error": _Column("fiu", "n", 0),
    "confidence": _Column("fiu", "n", 0, 1),
    "drawn": _NUMBERS,
    "filled_patch_size": _NUMBERS,
    "surface": _Column("fiu", "yx"),
    "surface_first": _Column("fiu", "2", *_PLACES),
    "surface_spacing": _Column("fiu"),
    "preset": _Column("U", "", 1, 100),
    "reason": _Column("iu", "n", 0, 4),
    "mode": _Column("iu", "n"),
    "magnification": _NUMBERS,
    "filled": _FLAGS,
    "saved_by": _Column("U", "s"),
    # A sum of shares of tiles may be a rounding error above 1.
    "saved": _Column("fiu", "s", 0, 1.01),
    "flat_samples": _Column("fiu", "m", *_PLACES),
    "centres": _Column("fiu", "n2", *_PLACES),
    "camera": _TEXT,
    "lens_blur": _TEXT,
    "kept": _FLAGS,
    "kept_cost": _NUMBERS,
    "kept_offset": _NUMBERS,
    "kept_error": _NUMBERS,
    "kept_clear": _FLAGS,
    "kept_textured": _FLAGS,
    "digest": _TEXT,
}


class DepthFileError(LightFieldError, ValueError):
    """A depth file is missing, damaged, or belongs to another camera.

    Examples
    --------
    >>> import lfrender
    >>> lfrender.DepthMap.load("no.npz")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    lfrender.data.depth_file.DepthFileError: no.npz: cannot be read as a depth file (No such file...
    """


def write_depth(depth: DepthMap, path: AnyPath) -> None:
    """Write as `.npz`; the file appears whole or not at all."""
    surface = depth.surface
    state = depth.frame_state
    values: Entries = {name: getattr(depth, name) for name in _SAVED}
    values |= {
        "version": np.int64(_VERSION),
        "drawn": depth.filled_patch_size,
        "surface": surface.patch_size,
        "surface_first": surface.first,
        "surface_spacing": surface.spacing,
        "saved_by": np.array(list(depth.saved), str),
        "saved": np.array(list(depth.saved.values()), np.float64),
        "lens_blur": depth.lens_blur and json.dumps(depth.lens_blur.to_dict()),
    }
    if state.reference is not None and state.kept is not None:
        # Without it, many small changes would pass once the depth has been loaded again.
        values["kept"] = state.kept
        values |= {f"kept_{name}": value for name, value in state.reference._asdict().items()}
    known = {name: np.asarray(value) for name, value in values.items() if value is not None}
    known["digest"] = np.array(digest_arrays(known))
    with atomic_write(Path(path)) as temporary, open(temporary, "wb") as stream:
        np.savez(stream, **known)  # type: ignore[arg-type]


def read_depth(path: AnyPath, make: Callable[..., DepthMap]) -> DepthMap:
    """A file of `write_depth`, from whose fields `make` makes a depth map."""
    remedy = "make one with 'lfrender analyze'"
    try:
        # np.load leaves a damaged file open if it opened it itself.
        with (
            open(open_regular(path), "rb") as stream,
            np.load(stream, allow_pickle=False) as file,
        ):
            _check_unpacked_size(stream)
            data = dict(file)
        version = int(data["version"])
        if version != _VERSION:
            raise ValueError(f"version {version} is not known (this is {_VERSION})")
        check_columns(data)
        depth = make(**_fields_of(data))
        _check_together(depth, data)
        return depth
    except OSError as error:
        raise DepthFileError(
            f"{path}: cannot be read as a depth file ({error.strerror or error})"
        ) from error
    # Damaged bytes can raise nearly any error in the readers of ZIP files and array headers.
    except Exception as error:
        problem = f"not a whole depth file ({one_line(error)})"
        raise DepthFileError(f"{path}: {problem}; {remedy}") from error


def _fields_of(data: Entries) -> Entries:
    """The fields of a depth map from the arrays of its file."""
    names = ("patch_size", "standard_error", "confidence", "pitch", "image_size", "preset")
    found = {name: data[name] for name in names}
    found |= {name: data[name] for name in ("reason", *_OPTIONAL) if np.size(data.get(name, ()))}
    # Numbers and texts as those of Python.
    found |= {name: value.tolist() for name, value in found.items() if value.dtype.kind == "U"}
    found["pitch"] = float(data["pitch"])
    for name in {"flat_samples", "centres"}.intersection(found):
        found[name] = found[name].astype(np.float32)
    x, y = data["surface_first"].tolist()
    values = np.ascontiguousarray(data["surface"], np.float32)
    found["surface"] = Surface(values, (x, y), float(data["surface_spacing"]))
    found["filled_patch_size"] = data["drawn"]
    if "saved" in data:
        pairs = zip(data["saved_by"].tolist(), data["saved"].tolist(), strict=True)
        found["saved"] = dict(pairs)
    if "lens_blur" in data:
        found["lens_blur"] = LensBlur.from_dict(json.loads(str(data["lens_blur"])))
    if "kept" in data:
        reference = LocalMatch(*(data[f"kept_{name}"] for name in LocalMatch._fields))
        found["frame_state"] = FrameState(reference, data["kept"])
    return found


def camera_digest(image_size: Size, pitch: float, centres: Singles) -> str:
    """Digest of what a depth map knows of its camera; `centres` (n, 2) [px]."""
    size = np.array(image_size, np.int64)
    return digest_arrays({"centres": centres, "image_size": size, "pitch": np.float64(pitch)})


def check_extent(depth: DepthMap) -> None:
    """DepthFileError if the surface is not a grid over the flat, or over a part that was asked."""
    first = np.array(depth.surface.first)
    beyond = depth.surface.last - np.array(depth.image_size) + 1
    border = max(_BORDER * depth.pitch, depth.surface.spacing)
    inside = max(-first.min(), beyond.max()) <= border
    covers = max(first.max(), -beyond.min()) <= border
    # The depth of a region of interest has the surface of that region.
    if not inside or not (covers or "roi" in depth.saved):
        size = "{} x {}".format(*depth.image_size)
        raise DepthFileError(
            f"the surface of the depth map lies not over the flat of {size} px; analyze again"
        )


def check_columns(data: dict[str, Array]) -> None:
    """ValueError if an array of a file has another type, shape or range than those of `_SCHEMA`."""
    lengths = {"2": 2}
    for name, column in _SCHEMA.items():
        values = data.get(name)
        # Empty arrays of files of earlier versions stand for unknown ones.
        if values is None or (name in _OPTIONAL and not values.size):
            continue
        axes = zip(column.axes, values.shape, strict=False)
        shape = tuple(lengths.setdefault(axis, length) for axis, length in axes)
        fits = values.ndim == len(column.axes) and values.shape == shape
        if not fits or values.dtype.kind not in column.kinds:
            raise ValueError(f"{name} cannot be {values.dtype} of shape {values.shape}")
        if column.kinds == "U":
            # Texts that cannot be encoded cannot be printed.
            "".join(values.ravel().tolist()).encode()
            values = np.char.str_len(values)
        right = (values >= column.least) & (values <= column.most)
        if column.gaps:
            right |= np.isnan(values)
        if not right.all():
            wrong = values[~right].flat[0]
            raise ValueError(f"{name} {wrong:.6g} is not from {column.least:g} to {column.most:g}")


def _check_together(depth: DepthMap, data: dict[str, Array]) -> None:
    """ValueError if the arrays of a file contradict each other, or were changed after `save`."""
    digest = data.pop("digest", None)
    if digest is not None and digest != digest_arrays(data):
        raise ValueError(
            "its arrays were changed after they were written; leave out 'digest' if you did that"
        )
    known = ~depth.filled
    sizes = depth.patch_size[known]
    derived = {name: getattr(depth, name) for name in ("mode", "filled", "magnification")}
    derived["drawn"] = np.where(known, depth.patch_size, depth.filled_patch_size)
    for name, values in derived.items():
        if name in data and not np.allclose(data[name], values, 1e-3, 1e-3, equal_nan=True):
            raise ValueError(f"{name} contradicts patch_size")
    if depth.centres is not None:
        if depth.camera not in (None, camera_digest(depth.image_size, depth.pitch, depth.centres)):
            raise ValueError("pitch, image_size and centres are those of different cameras")
        check_extent(depth)
        shown = depth.surface.at(depth.centres[known])
        opposite = np.abs(shown + sizes)
        # Depth edges and smoothing move single values; the other sign is wrong for all.
        if known.any() and np.median(opposite) < _NEGATED * np.median(np.abs(shown - sizes)):
            raise ValueError("surface contradicts patch_size")


def _check_unpacked_size(stream: Any) -> None:
    """ValueError if an archive would unpack to far more than its own size.

    `save` does not compress.
    """
    with ZipFile(stream) as archive:
        unpacked = sum(entry.file_size for entry in archive.infolist())
    size = os.fstat(stream.fileno()).st_size
    if unpacked > max(LARGEST_RATIO * size, SMALL):
        raise ValueError(f"its {size / 1e6:.1f} MB would unpack to {unpacked / 1e6:,.0f} MB")
