"""Pictures as the microscopy community stores them: OME-TIFF (`.ome.tif`) and OME-Zarr (`.zarr`, NGFF 0.5).

Pixels have the size of scene coordinates, in pixels of the flat, so that viewers lay pictures of any scale over each
other; the JSON text of other formats is the description.
"""

from __future__ import annotations

import json
import secrets
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import OutputError

from .metadata import EmbeddedMetadata

__all__ = ["is_ome_name", "ome_tags", "write_ome_zarr"]

Page = tuple[NDArray[Any], str]


def is_ome_name(path: Path) -> bool:
    """Whether the name asks for OME metadata: `.ome.tif`, `.ome.zarr`."""
    return Path(path.stem).suffix.lower() == ".ome" or ".ome." in path.name.lower()


def ome_tags(shape: tuple[int, ...], text: str) -> dict[str, Any]:
    """Options of tifffile for OME metadata of a picture of this shape, in place of those of plain TIFF."""
    about: dict[str, Any] = {"axes": "YX" if len(shape) == 2 else "YXS", "Description": text}
    # OME has no place for where a picture begins but those of planes, in any unit.
    for axis, size in zip("XY", np.diag(_affine(text)), strict=True):
        about |= {f"PhysicalSize{axis}": size, f"PhysicalSize{axis}Unit": "pixel"}
    return {"metadata": about, "description": None}


def _affine(text: str) -> NDArray[np.float64]:
    return np.array(json.loads(text).get("affine", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.float64)


def write_ome_zarr(path: Path, pages: list[Page], _embedded: EmbeddedMetadata, _compress: bool) -> None:
    """Write a picture as an OME-Zarr group with the array `0` (c, y, x) or (y, x); whole or not at all."""
    import zarr

    ((pixels, text),) = pages
    array = np.moveaxis(pixels, -1, 0) if pixels.ndim == 3 else pixels
    lead, affine = array.ndim - 2, _affine(text)
    axes = [{"name": "c", "type": "channel"}] * lead + [{"name": name, "type": "space"} for name in "yx"]
    moves = [
        {"type": "scale", "scale": [1.0] * lead + np.diag(affine)[::-1].tolist()},
        {"type": "translation", "translation": [0.0] * lead + affine[::-1, 2].tolist()},
    ]
    scales = [{"name": path.name, "axes": axes, "datasets": [{"path": "0", "coordinateTransformations": moves}]}]
    made = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        with zarr.config.set({"array.write_empty_chunks": True}):
            attributes = {"ome": {"version": "0.5", "multiscales": scales}, "description": text}
            group = zarr.create_group(str(made), attributes=attributes, zarr_format=3)
            names = ("c", "y", "x")[-array.ndim :]
            chunks = (*array.shape[:lead], *(min(512, n) for n in array.shape[lead:]))
            group.create_array("0", data=np.ascontiguousarray(array), chunks=chunks, dimension_names=names)
        made.replace(path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        shutil.rmtree(made, ignore_errors=True)
