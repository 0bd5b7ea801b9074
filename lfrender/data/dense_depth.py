"""Patch size of every pixel of the picture that `render` draws, and its files."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal import Optics, OutputError
from lfcal.runtime.arrays import Array, Booleans, Floats, Frozen, Singles
from lfcal.runtime.errors import check_type
from lfcal.runtime.output_file import atomic_write, check_output
from lfcal.runtime.packages import check_package

from ..runtime.types import AnyPath, Entries
from .depth_map import DEPTH_ADVICE, DepthMap, default_scale
from .rendering import Picture, PictureGrid, check_scale, scene_points
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
    "write_exr",
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
        255 where the nearest lens has a depth of its own, 128 likewise but beside a depth edge
        (which may be wrong by a pixel or two), 0 where the depth is filled in from around.
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
    _layers = ("patch_size", "validity", "standard_error")

    @property
    def resolved(self) -> Booleans:
        """(h, w) bool: where the nearest lens has a depth of its own."""
        return self.validity != FILLED


def dense_depth(depth: DepthMap, scale: float | None = None, fill: bool = True) -> DenseDepth:
    """Patch size at every pixel of the picture that `render` draws at `scale` [px per pitch].

    `scale` is by default that of `render`. Between the grid values of `DepthMap.surface` the patch
    size is interpolated linearly on one surface; across a depth edge it is the nearest value.
    Unresolved places get the depth of their surroundings if `fill`, else NaN. Errors are those of
    `render`.

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
    if scale is None:
        scale = default_scale(depth)
    grid = PictureGrid(depth.image_size, pitch, check_scale(scale, pitch))
    place = (grid.size[::-1], (grid.first, grid.first), grid.spacing)
    edge = edge_step(pitch)
    sizes = sample_surface_at(depth.surface, edge, *place)
    lens = depth.nearest_lens(*place)
    resolved = np.ones(sizes.shape, bool)
    error = np.full(sizes.shape, np.inf, np.float32)
    if lens is not None:
        resolved = ~depth.filled[lens]
        error[resolved] = depth.standard_error[lens][resolved]
    around = np.ones((3, 3), np.uint8)
    beside = cv2.dilate(sizes, around) - cv2.erode(sizes, around) >= edge
    validity = np.where(resolved, np.where(beside, EDGE, SEEN), FILLED).astype(np.uint8)
    if not fill:
        sizes[~resolved] = np.nan
    return DenseDepth(sizes, grid.affine(), pitch, validity, error)


def dense_distance(dense: DenseDepth, optics: Optics) -> Singles:
    """(h, w) float32 [m]: distance in front of the main lens; NaN where nothing can be imaged."""
    points = scene_points(dense.patch_size.shape, dense.affine)
    return optics.distance(dense.patch_size / dense.pitch, points).astype(np.float32)


def check_dense_file(path: AnyPath) -> None:
    """Raise OutputError if dense depth could not be written there."""
    check_output(path, set(DENSE_FORMATS))
    if Path(path).suffix.lower() == ".exr":
        check_package("OpenEXR", f"{path}: .exr files need", OutputError)


def write_dense(path: AnyPath, dense: DenseDepth, distance: Singles | None = None) -> None:
    """Write patch sizes [px], or distances, as 32-bit TIFF, OpenEXR or PFM.

    The distances are those of `dense_distance`.

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
    check_dense_file(path)
    suffix = path.suffix.lower()
    values = dense.patch_size
    content = "signed patch size [px]"
    if distance is not None:
        values = distance
        content = "distance in front of the main lens [m]"
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
            channels: dict[str, Array] = {
                "Y": values,
                "resolved": dense.resolved.astype(np.float32),
                "validity": dense.validity / np.float32(255),
                "standard_error": dense.standard_error,
            }
            write_exr(temporary, channels, json.dumps(about))
        else:
            _write_pages(temporary, values, dense, about)


def _write_pages(path: Path, values: Singles, dense: DenseDepth, about: Entries) -> None:
    import tifffile

    with tifffile.TiffWriter(path) as file:
        file.write(values, description=json.dumps(about), metadata=None)
        for text, name in _FURTHER.items():
            description = json.dumps(about | {"content": text})
            # Compressed unlike the first page: readers would take equal pages for a stack.
            options: Entries = {"description": description, "compression": "zlib"}
            file.write(getattr(dense, name), metadata=None, **options)


def write_exr(path: Path, channels: dict[str, Array], text: str) -> None:
    """Write channels (h, w), or (h, w, 3) and (h, w, 4) as `RGB` and `RGBA`, with a comment."""
    import OpenEXR

    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "comments": text,
    }
    layers = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    with OpenEXR.File(header, layers) as file:
        file.write(str(path))
