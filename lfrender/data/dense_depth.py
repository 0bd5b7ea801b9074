"""Patch size of every pixel of the picture that `render` draws, and its files."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal import OutputError
from lfcal.runtime.output_file import atomic_write, check_output

from .depth_map import DepthMap, default_scale
from .rendering import check_scale
from .surface import sample_surface

__all__ = ["DENSE_FORMATS", "DenseDepth", "dense_depth", "write_dense"]

DENSE_FORMATS = (".tif", ".tiff", ".pfm", ".exr")


@dataclass(frozen=True)
class DenseDepth:
    """Signed patch size on the grid of a picture.

    Parameters
    ----------
    patch_size : (h, w) float32 [px of the flat]
        Finite; unresolved places are filled from those around them.
    affine : (2, 3) float64
        From pixel `(u, v, 1)` to scene coordinates.
    pitch : float [px]
    """

    patch_size: NDArray[np.float32]
    affine: NDArray[np.float64]
    pitch: float


def dense_depth(depth: DepthMap, scale: float | None = None) -> DenseDepth:
    """Patch size at every pixel of the picture that `render` draws at `scale`, as the kernels read it.

    Between the grid values of `DepthMap.surface` it is linear on one surface, and the nearest across a depth edge.

    Parameters
    ----------
    depth : DepthMap
    scale : float, optional
        Pixels per pitch; by default that of `render`.

    Raises
    ------
    ValueError
        If `scale` is not between 0 and four times the pitch.
    """
    pitch = depth.pitch
    scale = check_scale(default_scale(depth) if scale is None else scale, pitch)
    spacing = pitch / scale
    width, height = depth.image_size
    shape = (max(1, round(height / spacing)), max(1, round(width / spacing)))
    first = 0.5 * spacing - 0.5
    out = sample_surface(depth.surface, pitch, shape, spacing)
    return DenseDepth(out, np.array([[spacing, 0.0, first], [0.0, spacing, first]]), pitch)


def write_dense(path: str | os.PathLike[str], dense: DenseDepth) -> None:
    """Write the patch sizes [px] as 32-bit TIFF or OpenEXR, with the affine as JSON, or as PFM; whole or not at all.

    Raises
    ------
    OutputError
        If the ending is none of these, the package OpenEXR is needed, or the folder cannot be written.
    """
    path = Path(path)
    check_output(path, set(DENSE_FORMATS))
    if path.suffix.lower() == ".exr" and find_spec("OpenEXR") is None:
        raise OutputError(f"{path}: .exr files need the package 'OpenEXR'; pip install 'lfrender[exr]'")
    with atomic_write(path) as temporary:
        if path.suffix.lower() == ".pfm":
            height, width = dense.patch_size.shape
            # Rows from the bottom up; the negative scale says little-endian.
            rows = np.ascontiguousarray(dense.patch_size[::-1], "<f4")
            Path(temporary).write_bytes(f"Pf\n{width} {height}\n-1.0\n".encode() + rows.tobytes())
            return
        about = {
            "software": "lfrender",
            "content": "signed patch size [px]",
            "pitch": dense.pitch,
            "affine": dense.affine.tolist(),
        }
        if path.suffix.lower() == ".exr":
            import OpenEXR

            header = {
                "compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "comments": json.dumps(about),
            }  # fmt: skip
            with OpenEXR.File(header, {"Y": np.ascontiguousarray(dense.patch_size)}) as file:
                file.write(str(temporary))
            return
        import tifffile

        tifffile.imwrite(temporary, dense.patch_size, description=json.dumps(about), metadata=None)
