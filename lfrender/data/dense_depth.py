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
from lfcal.runtime.arrays import Array, Booleans, Floats, Frozen, Singles
from lfcal.runtime.errors import check_type
from lfcal.runtime.output_file import atomic_write, check_output

from .depth_map import DEPTH_ADVICE, DepthMap, default_scale
from .rendering import Picture, PictureGrid, check_scale
from .surface import edge_step, sample_surface_at

__all__ = [
    "DENSE_FORMATS",
    "EDGE",
    "FILLED",
    "SEEN",
    "DenseDepth",
    "dense_depth",
    "dense_distance",
    "write_dense",
]

DENSE_FORMATS = (".tif", ".tiff", ".pfm", ".exr")
#: Codes of `DenseDepth.validity`.
FILLED = 0
EDGE = 128
SEEN = 255
# Fields that are further pages of a TIFF, by what is said about them.
_FURTHER = {
    "255 where a lens has a depth, 128 beside a depth edge, 0 where it is filled in": "validity",
    "standard error of s [px]": "standard_error",
}


@dataclass(frozen=True, eq=False)
class DenseDepth(Picture, Frozen):
    """Signed patch size on the grid of a picture, from `dense_depth`; as an array, its patch sizes.

    Parameters
    ----------
    patch_size : (h, w) float32 [px of the flat]
        Where nothing is resolved, filled from the places around, or NaN.
    affine : (2, 3) float64
        From pixel `(u, v, 1)` to scene coordinates.
    pitch : float [px]
    validity : (h, w) uint8
        255 where the nearest lens has a depth of its own, 128 where one has beside a depth edge,
        which may lie a pixel or two elsewhere, 0 where the depth is filled in from around.
    standard_error : (h, w) float32 [px of the flat]
        Of `patch_size`, that of the nearest lens; inf where it is filled in.

    Examples
    --------
    >>> import lfrender
    >>> dense_depth(lfrender.data.example()[2], scale=6).resolved.shape
    (47, 62)
    """

    patch_size: Singles
    affine: Floats
    pitch: float
    validity: NDArray[np.uint8]
    standard_error: Singles

    @property
    def resolved(self) -> Booleans:
        """(h, w) bool: where the nearest lens has a depth of its own."""
        return self.validity != FILLED

    def _layers(self) -> dict[str, Array]:
        return {
            "patch_size": self.patch_size,
            "validity": self.validity,
            "standard_error": self.standard_error,
        }


def dense_depth(depth: DepthMap, scale: float | None = None, fill: bool = True) -> DenseDepth:
    """Patch size at every pixel of the picture that `render` draws at `scale` [px per pitch], by
    default its own.

    Between the grid values of `DepthMap.surface` it is linear on one surface, and the nearest
    across a depth edge. Unresolved places have the depth of those around them if `fill`, else NaN.
    Errors are those of `render`.

    Examples
    --------
    >>> import lfrender
    >>> dense = dense_depth(lfrender.data.example()[2], scale=6)
    >>> dense.patch_size.shape, dense.pitch
    ((47, 62), 23.2)
    """
    import cv2

    check_type(depth, DepthMap, "depth", DEPTH_ADVICE)
    pitch = depth.pitch
    grid = PictureGrid(
        depth.image_size,
        pitch,
        check_scale(default_scale(depth) if scale is None else scale, pitch),
    )
    shape = grid.size[::-1]
    edge = edge_step(pitch)
    around = np.ones((3, 3), np.uint8)
    sizes = sample_surface_at(depth.surface, edge, shape, (grid.first, grid.first), grid.spacing)
    lens = depth.nearest_lens(shape, (grid.first, grid.first), grid.spacing)
    error = depth.standard_error[lens] if lens is not None else np.full(shape, np.inf, np.float32)
    resolved = ~depth.filled[lens] if lens is not None else np.ones(shape, bool)
    beside = cv2.dilate(sizes, around) - cv2.erode(sizes, around) >= edge
    validity = np.where(resolved, np.where(beside, EDGE, SEEN), FILLED).astype(np.uint8)
    if not fill:
        sizes[~resolved] = np.nan
    return DenseDepth(
        sizes, grid.affine(), pitch, validity, np.where(resolved, error, np.float32(np.inf))
    )


def dense_distance(dense: DenseDepth, optics: Optics) -> Singles:
    """(h, w) float32 [m]: distance in front of the main lens at every pixel; NaN where nothing can
    be imaged there.
    """
    v, u = np.indices(dense.patch_size.shape)
    points = np.stack([u, v, np.ones_like(u)], axis=-1) @ dense.affine.T
    return optics.distance(dense.patch_size / dense.pitch, points).astype(np.float32)


def write_dense(
    path: str | os.PathLike[str], dense: DenseDepth, distance: Singles | None = None
) -> None:
    """Write the patch sizes [px], or the `distance` of `dense_distance`, as 32-bit TIFF, OpenEXR,
    or PFM.

    Affine, validity and standard errors [px] are JSON and two pages of the TIFF, comment and
    channels of OpenEXR; PFM has no room for them. OutputError if the ending is another, the package
    OpenEXR is needed, or nothing can be written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> with TemporaryDirectory() as folder:
    ...     write_dense(f"{folder}/depth.tif", dense_depth(lfrender.data.example()[2], scale=6))
    ...     Path(folder, "depth.tif").exists()
    True
    """
    check_type(
        dense, DenseDepth, "dense", "lfrender.data.dense_depth.dense_depth makes one of a DepthMap"
    )
    path = Path(path)
    check_output(path, set(DENSE_FORMATS))
    suffix = path.suffix.lower()
    values = dense.patch_size if distance is None else distance
    if suffix == ".exr" and find_spec("OpenEXR") is None:
        raise OutputError(
            f"{path}: .exr files need the package 'OpenEXR'; pip install 'lfrender[exr]'"
        )
    content = (
        "signed patch size [px]" if distance is None else "distance in front of the main lens [m]"
    )
    about = {
        "software": "lfrender",
        "content": content,
        "pitch": dense.pitch,
        "affine": dense.affine.tolist(),
    }
    with atomic_write(path) as temporary:
        if suffix == ".pfm":
            # Rows from the bottom up; the negative scale says little-endian.
            head = "Pf\n{1} {0}\n-1.0\n".format(*values.shape)
            temporary.write_bytes(head.encode() + values[::-1].astype("<f4").tobytes())
        elif suffix == ".exr":
            import OpenEXR

            kind = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
            channels = {
                "Y": np.ascontiguousarray(values),
                "resolved": dense.resolved.astype(np.float32),
                "validity": dense.validity / np.float32(255),
                "standard_error": dense.standard_error,
            }
            with OpenEXR.File(kind | {"comments": json.dumps(about)}, channels) as file:
                file.write(str(temporary))
        else:
            import tifffile

            with tifffile.TiffWriter(temporary) as file:
                file.write(values, description=json.dumps(about), metadata=None)
                for text, name in _FURTHER.items():
                    # Deflated: readers would take pages of one kind for a stack.
                    page = getattr(dense, name)
                    description = json.dumps(about | {"content": text})
                    file.write(page, description=description, metadata=None, compression="zlib")
