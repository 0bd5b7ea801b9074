"""Patch size of every pixel of the picture that `render` draws, and its files."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal import Optics, OutputError
from lfcal.runtime.arrays import Frozen
from lfcal.runtime.output_file import atomic_write, check_output

from .depth_map import DepthMap, default_scale
from .rendering import PictureGrid, check_scale
from .surface import edge_step, sample_surface_at

__all__ = ["DENSE_FORMATS", "DenseDepth", "dense_depth", "dense_distance", "write_dense"]

DENSE_FORMATS = (".tif", ".tiff", ".pfm", ".exr")


@dataclass(frozen=True, eq=False)
class DenseDepth(Frozen):
    """Signed patch size on the grid of a picture, from `dense_depth`.

    Parameters
    ----------
    patch_size : (h, w) float32 [px of the flat]
        Where nothing is resolved, filled from the places around, or NaN.
    affine : (2, 3) float64
        From pixel `(u, v, 1)` to scene coordinates.
    pitch : float [px]
    resolved : (h, w) bool
        Where the nearest lens has a depth of its own.

    Examples
    --------
    >>> import lfrender
    >>> dense_depth(lfrender.data.example()[2], scale=6).resolved.shape
    (47, 62)
    """

    patch_size: NDArray[np.float32]
    affine: NDArray[np.float64]
    pitch: float
    resolved: NDArray[np.bool_]


def dense_depth(depth: DepthMap, scale: float | None = None, fill: bool = True) -> DenseDepth:
    """Patch size at every pixel of the picture that `render` draws at `scale`, as the kernels read it.

    Between the grid values of `DepthMap.surface` it is linear on one surface, and the nearest across a depth edge.

    Parameters
    ----------
    depth : DepthMap
    scale : float, optional
        Pixels per pitch; by default that of `render`. ValueError beyond four times the pitch.
    fill : bool
        Whether unresolved places have the depth of those around them; else NaN.

    Examples
    --------
    >>> import lfrender
    >>> dense = dense_depth(lfrender.data.example()[2], scale=6)
    >>> dense.patch_size.shape, dense.pitch
    ((47, 62), 23.2)
    """
    pitch = depth.pitch
    grid = PictureGrid(depth.image_size, pitch, check_scale(default_scale(depth) if scale is None else scale, pitch))
    shape = grid.size[::-1]
    place = shape, (grid.first, grid.first), grid.spacing
    out = sample_surface_at(depth.surface, edge_step(pitch), *place)
    resolved = ~depth.unresolved_places(*place)
    if not fill:
        out[~resolved] = np.nan
    return DenseDepth(out, grid.affine(), pitch, resolved)


def dense_distance(dense: DenseDepth, optics: Optics) -> NDArray[np.float32]:
    """(h, w) float32 [m]: distance in front of the main lens at every pixel; NaN where nothing can be imaged there."""
    height, width = dense.patch_size.shape
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    points = np.stack([u, v, np.ones_like(u)], axis=-1) @ dense.affine.T
    return optics.distance(dense.patch_size / dense.pitch, points).astype(np.float32)


def write_dense(path: str | os.PathLike[str], dense: DenseDepth, distance: NDArray[np.float32] | None = None) -> None:
    """Write the patch sizes [px] as 32-bit TIFF or OpenEXR, with the affine as JSON, or as PFM; whole or not at all.

    With `distance`, as `dense_distance` makes it, that is written in their place. A second page of the TIFF, or a
    channel "resolved" of OpenEXR, is not 0 where a lens has a depth; PFM has no room for it. OutputError if the ending
    is none of these, the package OpenEXR is needed, or the folder cannot be written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> with TemporaryDirectory() as folder:
    ...     write_dense(f"{folder}/depth.tif", dense_depth(lfrender.data.example()[2], scale=6))
    ...     Path(folder, "depth.tif").exists()
    True
    """
    path = Path(path)
    check_output(path, set(DENSE_FORMATS))
    suffix, values = path.suffix.lower(), dense.patch_size if distance is None else distance
    if suffix == ".exr" and find_spec("OpenEXR") is None:
        raise OutputError(f"{path}: .exr files need the package 'OpenEXR'; pip install 'lfrender[exr]'")
    about = {
        "software": "lfrender",
        "content": "signed patch size [px]" if distance is None else "distance in front of the main lens [m]",
        "pitch": dense.pitch,
        "affine": dense.affine.tolist(),
    }
    with atomic_write(path) as temporary:
        if suffix == ".pfm":
            height, width = values.shape
            # Rows from the bottom up; the negative scale says little-endian.
            rows = np.ascontiguousarray(values[::-1], "<f4")
            temporary.write_bytes(f"Pf\n{width} {height}\n-1.0\n".encode() + rows.tobytes())
        elif suffix == ".exr":
            import OpenEXR

            kind = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
            channels = {"Y": np.ascontiguousarray(values), "resolved": dense.resolved.astype(np.float32)}
            with OpenEXR.File(kind | {"comments": json.dumps(about)}, channels) as file:
                file.write(str(temporary))
        else:
            import tifffile

            with tifffile.TiffWriter(temporary) as file:
                file.write(values, description=json.dumps(about), metadata=None)
                about["content"] = "255 where a lens has a depth, 0 where it is filled in"
                file.write(255 * dense.resolved.astype(np.uint8), description=json.dumps(about), metadata=None)
