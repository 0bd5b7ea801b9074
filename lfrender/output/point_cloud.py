"""The scene as points or as a mesh, in virtual depth or metres; PLY, PCD and glTF files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from lfcal import Calibration, LightFieldError, Optics, OutputError
from lfcal.runtime.arrays import Array, Floats
from lfcal.runtime.errors import check_type
from lfcal.runtime.output_file import atomic_write, check_output
from lfcal.runtime.packages import check_package

from ..data.dense_depth import DenseDepth, dense_depth
from ..data.depth_map import DepthMap, check_depth
from ..data.rendering import scene_points
from ..data.surface import edge_step
from ..rendering.render import render
from ..runtime.types import AnyPath
from .finish import to_display

__all__ = [
    "CLOUD_SUFFIXES",
    "MESH_SUFFIXES",
    "check_mesh_file",
    "mesh",
    "point_cloud",
    "write_mesh",
    "write_points",
]

CLOUD_SUFFIXES = (".ply", ".pcd")
MESH_SUFFIXES = (".glb", ".ply")

_POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
)
# Largest virtual depth [pitches]: it has a pole where the patch size is 0.
_FARTHEST = 50
# What coordinates are, not in metres and in metres.
_AXES = (
    "x, y: scene coordinates over the pitch D; z: signed virtual depth D / s",
    "metres; x right, y down, z in front of the main lens",
)


def point_cloud(
    flat: Array,
    calibration: Calibration,
    depth: DepthMap,
    optics: Optics | None = None,
    *,
    points_per_pitch: float = 7.0,
) -> Array:
    """Every resolved place of the scene as a point.

    CalibrationError if `depth` belongs to another camera.

    Parameters
    ----------
    flat, calibration, depth
        As for `render`.
    optics : Optics, optional
        Gives positions in metres; where its principal point is not known the axis of the main lens
        is taken to meet the middle of the flat. By default those of the calibration, if it has any.
    points_per_pitch : float
        Density of the points; 7 is as fine as the depth is resolved.

    Returns
    -------
    (n,) structured array
        `x, y` scene coordinates over the pitch `D`, `z` the signed virtual depth `D / s` (positive:
        in front of the microlenses), all float32; `red, green, blue` 0..255. Those farther than 50
        pitches are left out. With `optics`, `x` to the right, `y` down and `z` in front of the main
        lens [m]; places at infinity are left out.

    Examples
    --------
    >>> import lfrender
    >>> point_cloud(*lfrender.data.example(), points_per_pitch=4).dtype.names
    ('x', 'y', 'z', 'red', 'green', 'blue')
    """
    dense, places, _ = _places(calibration, depth, optics, points_per_pitch)
    picture = render(flat, calibration, depth, scale=depth.pitch / dense.affine[0, 0])
    known = picture.valid & np.isfinite(places).all(-1)
    points = np.empty(known.sum(), _POINT)
    points["x"], points["y"], points["z"] = places[known].T
    colours = to_display(picture)[known].reshape(len(points), -1)
    points["red"], points["green"], points["blue"] = np.broadcast_to(colours, (len(points), 3)).T
    return points


def mesh(
    flat: Array,
    calibration: Calibration,
    depth: DepthMap,
    optics: Optics | None = None,
    *,
    points_per_pitch: float = 7.0,
) -> Any:
    """The scene as triangles between neighbouring points, textured with its picture.

    Arguments, axes, units and errors are those of `point_cloud`. There are no triangles across
    depth edges, nor where no lens has a depth. LightFieldError if the package `trimesh` is not
    installed.

    Returns
    -------
    trimesh.Trimesh
        Its front is toward the camera; `metadata["axes"]` says what the coordinates are.

    Examples
    --------
    >>> import lfrender
    >>> surface = mesh(*lfrender.data.example(), points_per_pitch=4)
    >>> surface.faces.shape[1], surface.visual.material.baseColorTexture.size
    (3, (71, 54))
    """
    check_package("trimesh", "meshes need", LightFieldError)
    from PIL import Image
    from trimesh import Trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    dense, places, metres = _places(calibration, depth, optics, points_per_pitch)
    picture = render(flat, calibration, depth)
    height, width = picture.valid.shape
    scene = scene_points(dense.patch_size.shape, dense.affine)
    pixels = (scene - picture.affine[:, 2]) / np.diag(picture.affine)
    u, v = np.moveaxis(np.rint(pixels).astype(int).clip(0, (width - 1, height - 1)), -1, 0)
    known = (picture.valid[v, u] & np.isfinite(places).all(-1)).ravel()
    number = np.arange(known.size).reshape(dense.patch_size.shape)
    below = number[1:, :-1]
    beside = number[:-1, 1:]
    halves = np.array([[number[:-1, :-1], below, beside], [beside, below, number[1:, 1:]]])
    triangles = np.moveaxis(halves, 1, -1).reshape(-1, 3)
    same = np.ptp(dense.patch_size.ravel()[triangles], axis=1) < edge_step(depth.pitch)
    used, faces = np.unique(triangles[same & known[triangles].all(1)], return_inverse=True)
    # Textures begin at the bottom left.
    texture = Image.fromarray(to_display(picture)).convert("RGB")
    place = (pixels.reshape(-1, 2)[used] + 0.5) / (width, height) * (1, -1) + (0, 1)
    material = PBRMaterial(
        baseColorTexture=texture, metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True
    )
    look = TextureVisuals(place, material=material)
    about = {"axes": _AXES[metres]}
    corners = places.reshape(-1, 3)[used]
    return Trimesh(corners, faces.reshape(-1, 3), visual=look, process=False, metadata=about)


def _places(
    calibration: Calibration, depth: DepthMap, optics: Optics | None, points_per_pitch: float
) -> tuple[DenseDepth, Floats, bool]:
    """Dense depth, places (h, w, 3) of its pixels, and whether these are in metres.

    Places are NaN where there is no depth.
    """
    check_depth(depth, calibration)
    optics = optics or calibration.optics
    dense = dense_depth(depth, min(points_per_pitch, depth.pitch))
    scene = scene_points(dense.patch_size.shape, dense.affine)
    ratio = dense.patch_size.astype(np.float64) / depth.pitch
    ratio[~dense.resolved | (np.abs(ratio) * _FARTHEST < 1)] = np.nan
    if optics is None:
        return dense, np.dstack([scene / depth.pitch, 1 / ratio]), False
    middle = (np.array(depth.image_size) - 1) / 2
    found = optics.positions(scene.reshape(-1, 2), ratio.ravel(), middle)
    return dense, found.reshape(*scene.shape[:2], 3), True


def write_points(path: AnyPath, points: Array, metres: bool = False) -> None:
    """Write the points of `point_cloud` as binary PLY or PCD; whole or not at all.

    `metres`: they were made with optics.

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
    check_type(points, np.ndarray, "points", "lfrender.output.point_cloud.point_cloud makes one")
    check_output(path, CLOUD_SUFFIXES)
    if Path(path).suffix.lower() == ".pcd":
        # The colour is a whole number 0xRRGGBB: four bytes, blue first.
        four = [(name, "u1") for name in ("blue", "green", "red", "none")]
        packed = np.zeros(len(points), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), *four])
        for name in _POINT.names or ():
            packed[name] = points[name]
        data = packed.tobytes()
        header = [
            "# .PCD v0.7 - Point Cloud Data file format",
            "VERSION 0.7",
            "FIELDS x y z rgb",
            "SIZE 4 4 4 4",
            "TYPE F F F U",
            "COUNT 1 1 1 1",
            f"WIDTH {len(points)}",
            "HEIGHT 1",
            "VIEWPOINT 0 0 0 1 0 0 0",
            f"POINTS {len(points)}",
            "DATA binary\n",
        ]
    else:
        data = points.astype(_POINT).tobytes()
        header = [
            "ply",
            "format binary_little_endian 1.0",
            f"comment {_AXES[metres]}",
            f"element vertex {len(points)}",
            *(f"property float {name}" for name in "xyz"),
            *(f"property uchar {name}" for name in ("red", "green", "blue")),
            "end_header\n",
        ]
    with atomic_write(path) as temporary:
        temporary.write_bytes("\n".join(header).encode() + data)


def check_mesh_file(path: AnyPath) -> None:
    """Raise an error if a mesh could not be made, or not be written there."""
    check_output(path, MESH_SUFFIXES)
    check_package("trimesh", f"{path}: meshes need", OutputError)


def write_mesh(path: AnyPath, surface: Any) -> None:
    """Write a mesh as glTF (`.glb`) with its texture, or as PLY with colours.

    glTF has its own axes: x right, y up, z toward the viewer. PLY keeps those of the points.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> with TemporaryDirectory() as folder:
    ...     write_mesh(f"{folder}/scene.glb", mesh(*lfrender.data.example(), points_per_pitch=4))
    ...     Path(folder, "scene.glb").read_bytes()[:4]
    b'glTF'
    """
    check_mesh_file(path)
    shown = surface.copy()
    if Path(path).suffix.lower() == ".glb":
        data = shown.apply_transform(np.diag([1.0, -1.0, -1.0, 1.0])).export(file_type="glb")
    else:
        shown.visual = shown.visual.to_color()
        comment = f"\ncomment {surface.metadata['axes']}\nelement vertex".encode()
        data = shown.export(file_type="ply", include_attributes=False).replace(
            b"\nelement vertex", comment, 1
        )
    with atomic_write(path) as temporary:
        temporary.write_bytes(data)
