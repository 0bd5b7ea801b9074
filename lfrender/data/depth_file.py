"""Files of depth maps: `.npz` with the arrays of the fields, and others for other programs."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import ZipFile

import numpy as np

from lfcal import LensBlur, LightFieldError
from lfcal.runtime.input_file import open_regular
from lfcal.runtime.output_file import atomic_write

from ..runtime.messages import one_line
from ..runtime.types import AnyPath
from .frame_state import FrameState, LocalMatch
from .surface import Surface

if TYPE_CHECKING:
    from .depth_map import DepthMap

__all__ = ["LARGEST_RATIO", "SMALL", "DepthFileError", "read_depth", "write_depth"]

# Version of the files; version 1 had the lenses of some arrays in another order.
_VERSION = 2
# Limits for files that somebody has compressed: unpacked bytes over those of the file, and unpacked
# bytes that are always accepted.
LARGEST_RATIO = 50
SMALL = 1 << 26
# Arrays and numbers of a file that bear the name of their field; derived ones are for other
# programs.
_SAVED = (
    "patch_size",
    "standard_error",
    "confidence",
    "reason",
    "pitch",
    "image_size",
    "preset",
    "mode",
    "magnification",
    "filled",
)
_OPTIONAL = ("flat_samples", "centres")


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
    reference = depth.frame_state.reference
    kept = depth.frame_state.kept
    values: dict[str, Any] = {"version": np.int64(_VERSION)}
    values["surface_spacing"] = surface.spacing
    values |= {name: getattr(depth, name) for name in (*_SAVED, *_OPTIONAL)}
    values |= {
        "drawn": depth.filled_patch_size,
        "surface": surface.patch_size,
        "surface_first": surface.first,
        "saved_by": np.array(list(depth.saved), str),
        "saved": np.array(list(depth.saved.values()), np.float64),
        "lens_blur": depth.lens_blur and json.dumps(depth.lens_blur.to_dict()),
    }
    if reference is not None and kept is not None:
        # Without it, many small changes would pass once the depth has been loaded again.
        values["kept"] = kept
        values |= {f"kept_{name}": value for name, value in reference._asdict().items()}
    known = {name: value for name, value in values.items() if value is not None}
    with atomic_write(Path(path)) as temporary, open(temporary, "wb") as stream:
        np.savez(stream, **known)


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
            raise DepthFileError(
                f"{path}: version {version} is not known (this is {_VERSION}); {remedy}"
            )
        return make(**_fields_of(data))
    except DepthFileError:
        raise
    except OSError as error:
        raise DepthFileError(
            f"{path}: cannot be read as a depth file ({error.strerror or error})"
        ) from error
    # Damaged bytes can raise nearly any error in the readers of ZIP files and array headers.
    except Exception as error:
        problem = f"not a whole depth file ({one_line(error)})"
        raise DepthFileError(f"{path}: {problem}; {remedy}") from error


def _fields_of(data: dict[str, Any]) -> dict[str, Any]:
    """The fields of a depth map from the arrays of its file."""
    found: dict[str, Any] = {
        name: data[name] for name in ("patch_size", "standard_error", "confidence")
    }
    place = (tuple(data["surface_first"].tolist()), float(data["surface_spacing"]))
    found |= {
        "filled_patch_size": data["drawn"],
        "surface": Surface(np.ascontiguousarray(data["surface"], np.float32), *place),
        "pitch": float(data["pitch"]),
        "image_size": tuple(data["image_size"].tolist()),
        "preset": str(data["preset"]),
        "reason": data.get("reason"),
    }
    if "saved" in data:
        pairs = zip(data["saved_by"].tolist(), data["saved"].tolist(), strict=True)
        found["saved"] = dict(pairs)
    for name in _OPTIONAL:
        if name in data and data[name].size:
            found[name] = data[name].astype(np.float32)
    if "lens_blur" in data:
        found["lens_blur"] = LensBlur.from_dict(json.loads(str(data["lens_blur"])))
    if "kept" in data:
        reference = LocalMatch(*(data[f"kept_{name}"] for name in LocalMatch._fields))
        found["frame_state"] = FrameState(reference, data["kept"])
    return found


def _check_unpacked_size(stream: Any) -> None:
    """ValueError if an archive would unpack to far more than its own size.

    `save` does not compress.
    """
    with ZipFile(stream) as archive:
        unpacked = sum(entry.file_size for entry in archive.infolist())
    size = os.fstat(stream.fileno()).st_size
    if unpacked > max(LARGEST_RATIO * size, SMALL):
        raise ValueError(f"its {size / 1e6:.1f} MB would unpack to {unpacked / 1e6:,.0f} MB")
