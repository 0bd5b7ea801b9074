"""The scene as points in virtual-depth units or metres, with the colours of the picture; their PLY and PCD files."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, CalibrationError, Optics
from lfcal.runtime.output_file import atomic_write, check_output

from ..data.dense_depth import dense_depth
from ..data.depth_map import DepthMap
from ..flat.gray_flat import white_level
from ..rendering.render import render

__all__ = ["CLOUD_SUFFIXES", "point_cloud", "write_points"]

CLOUD_SUFFIXES = frozenset({".ply", ".pcd"})

_POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")])


def point_cloud(
    flat: NDArray,
    calibration: Calibration,
    depth: DepthMap,
    optics: Optics | None = None,
    *,
    points_per_pitch: float = 7.0,
) -> NDArray:
    """Every resolved place of the scene as a point; CalibrationError if `depth` belongs to another camera.

    Parameters
    ----------
    flat, calibration, depth
        As for `render`.
    optics : Optics, optional
        Gives positions in metres; where its principal point is not known the axis of the main lens is taken to meet the
        middle of the flat. By default those of the calibration, if it has any.
    points_per_pitch : float
        Density of the points; 7 is as fine as the depth is resolved.

    Returns
    -------
    (n,) structured array
        `x, y` scene coordinates over the pitch `D`, `z` the signed virtual depth `D / s` (positive: in front of the
        microlenses), all float32; `red, green, blue` 0..255. Those farther than 50 pitches are left out. With `optics`,
        `x` to the right, `y` down and `z` in front of the main lens [m]; places at infinity are left out.

    Examples
    --------
    >>> import lfrender
    >>> point_cloud(*lfrender.data.example(), points_per_pitch=4).dtype.names
    ('x', 'y', 'z', 'red', 'green', 'blue')
    """
    if depth.image_size != calibration.image_size or len(depth) != len(calibration.lattice):
        raise CalibrationError("the depth map was made with another camera or flat size; analyze this flat")
    optics = optics or calibration.optics
    scale = min(points_per_pitch, depth.pitch)
    picture = render(flat, calibration, depth, scale=scale)
    dense = dense_depth(depth, scale)
    # Virtual depth has a pole at s = 0.
    v, u = np.nonzero(picture.valid & dense.resolved & (np.abs(dense.patch_size) * 50 >= depth.pitch))
    scene = np.column_stack([u, v, np.ones(len(u))]).astype(np.float64) @ dense.affine.T
    size = dense.patch_size[v, u]
    points = np.empty(len(u), _POINT)
    if optics is None:
        places = np.column_stack([scene / depth.pitch, depth.pitch / size])
    else:
        places = optics.positions(scene, size / depth.pitch, (np.array(depth.image_size) - 1) / 2)
    points["x"], points["y"], points["z"] = places.T
    colours = picture.image[v, u].reshape(len(u), -1).astype(np.float64) * (
        255 / white_level(picture.image, calibration)
    )
    points["red"], points["green"], points["blue"] = np.clip(np.rint(np.broadcast_to(colours, (len(u), 3))), 0, 255).T
    return points[np.isfinite(points["z"])]


def write_points(path: str | os.PathLike[str], points: NDArray, metres: bool = False) -> None:
    """Write the points of `point_cloud`, made with optics if `metres`, as binary PLY or PCD; whole or not at all.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> points = point_cloud(*lfrender.data.example(), points_per_pitch=4)
    >>> with TemporaryDirectory() as folder:
    ...     write_points(f"{folder}/cloud.ply", points)
    ...     Path(folder, "cloud.ply").read_bytes()[:3]
    b'ply'
    """
    check_output(path, CLOUD_SUFFIXES)
    if Path(path).suffix.lower() == ".pcd":
        # The colour is a whole number 0xRRGGBB.
        red, green, blue = (points[name].astype(np.uint32) for name in ("red", "green", "blue"))
        place = np.column_stack([points[name] for name in "xyz"]).astype("<f4")
        data = np.column_stack([place.view("<u4"), red << 16 | green << 8 | blue]).tobytes()
        header = [
            "# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7", "FIELDS x y z rgb", "SIZE 4 4 4 4",
            "TYPE F F F U", "COUNT 1 1 1 1", f"WIDTH {len(points)}", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0",
            f"POINTS {len(points)}", "DATA binary\n",
        ]  # fmt: skip
    else:
        data = points.astype(_POINT).tobytes()
        virtual = "x, y: scene coordinates over the pitch D; z: signed virtual depth D / s"
        header = [
            "ply", "format binary_little_endian 1.0",
            f"comment {'metres; x right, y down, z in front of the main lens' if metres else virtual}",
            f"element vertex {len(points)}", *(f"property float {name}" for name in "xyz"),
            *(f"property uchar {name}" for name in ("red", "green", "blue")), "end_header\n",
        ]  # fmt: skip
    with atomic_write(path) as temporary:
        temporary.write_bytes("\n".join(header).encode() + data)
