"""Views with their cameras, depth and masks, in the forms of programs for many views.

nerfstudio: `transforms.json`; COLMAP: a sparse model as text, with points and the views that see
each, and the maps that its stereo fusion reads; rvs: the camera file of MPEG's view synthesis (RVS,
TMIV) with raw video. Each camera stands in the axes that its program has.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, Optics, OutputError
from lfcal.runtime.arrays import Array, Booleans, Floats, Singles
from lfcal.runtime.output_file import atomic_write, make_folder, refuse_leftovers

from ..data.depth_map import DepthMap
from ..data.rendering import Rendering, scene_points
from ..runtime.choices import PoseFormat
from ..runtime.types import AnyPath, Entries, Place
from .finish import Finish, to_display
from .picture import write_finished, write_picture
from .poses import ViewCamera, ViewRig, view_rig
from .raw_video import check_raw_format, frame_bytes, yuv_frame

__all__ = ["POSE_FORMATS", "check_posed_folder", "write_posed_views"]

_VIEW_FILES = r"view_\d{3,}\..+"
# Share of the pixels whose depth, mostly wrong, lies beyond the range of disparities; and by how
# much of itself the range is widened, so that its ends are not rounded away.
_RARE = 1e-3
# Colour differences of no colour, of 16 bits.
_GREY = 0x8000
# Distance of the pixels of the middle view that become points [px].
_TRACK_STEP = 4
# Endings of the names of masks, as each program looks for them, and of the maps for stereo fusion.
_MASKS = {"nerfstudio": ".png", "colmap": ".png.png"}
_MAPS = ".png.geometric.bin"


def _view_name(number: int) -> str:
    return f"view_{number:03d}"


class _Posed(NamedTuple):
    """A view as it is written."""

    name: str
    picture: Rendering
    depth: Singles  # (h, w)
    camera: ViewCamera
    known: Booleans  # (h, w) pixels that were seen, at a finite distance
    centre: list[float]  # principal point where pixel (0, 0) reaches from 0 to 1


def check_posed_folder(folder: AnyPath, kind: PoseFormat, count: int) -> None:
    """OutputError if `count` new posed views would leave some of an earlier run.

    PictureError if a package that they need is not installed.
    """
    if kind == "rvs":
        check_raw_format(folder, "yuv")
    endings = {
        "images": (".png",),
        "depth": (".png", ".exr", ".tif"),
        "masks": (_MASKS.get(kind, ""),),
        "stereo/depth_maps": (_MAPS,),
        "stereo/normal_maps": (_MAPS,),
    }
    for place, those in endings.items():
        kept = [_view_name(number) + ending for number in range(count) for ending in those]
        refuse_leftovers(Path(folder) / place, _VIEW_FILES, kept)


def write_posed_views(
    folder: AnyPath,
    kind: PoseFormat,
    views: Iterable[tuple[Rendering, Singles]],
    calibration: Calibration,
    depth: DepthMap,
    offsets: list[Place],
    still: float,
    optics: Optics | None = None,
) -> ViewRig:
    """Write views with intrinsics, extrinsics, depth and masks.

    OutputError or PictureError if that fails.

    Views of an earlier run that these do not replace are an OutputError too. The folder is made
    where it does not exist; `kind` is `"nerfstudio"`, `"colmap"` or `"rvs"`. The views are as
    `views_with_depth` yields them for `offsets` and `still`; the rest is as for `view_rig`.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> from lfrender.rendering.viewpoints import views_with_depth
    >>> flat, camera, depth = lfrender.data.example()
    >>> offsets = [(-4.0, 0.0), (4.0, 0.0)]
    >>> pairs = views_with_depth(flat, camera, depth, offsets=offsets, scale=6, still=-7.0)
    >>> with TemporaryDirectory() as folder:
    ...     rig = write_posed_views(folder, "nerfstudio", pairs, camera, depth, offsets, still=-7.0)
    >>> len(rig.cameras)
    2
    """
    if kind not in POSE_FORMATS:
        raise OutputError(
            f"{folder}: poses are written for {', '.join(POSE_FORMATS)}, not {kind!r}"
        )
    check_posed_folder(folder, kind, len(offsets))
    target = make_folder(folder)
    drawn = list(views)
    affine = drawn[0][0].affine
    shape = drawn[0][1].shape
    rig = view_rig(calibration, depth, offsets, affine, shape[::-1], still, optics)
    places = scene_points(shape, affine)
    posed = []
    for number, (picture, sizes) in enumerate(drawn):
        camera = rig.cameras[number]
        moved = np.array(offsets[number]) * (depth.pitch / still)
        distance = rig.depth(number, sizes, places + moved)
        known = picture.valid & np.isfinite(distance) & (distance > 0)
        centre = [at + 0.5 for at in camera.principal_point]
        posed.append(_Posed(_view_name(number), picture, distance, camera, known, centre))
    POSE_FORMATS[kind](target, posed, rig)
    return rig


def _write_files(folder: Path, views: list[_Posed], mask: str) -> float:
    """Write pictures, depth and masks; returns the unit of the 16-bit depth files."""
    images, distances, masks = (make_folder(folder / name) for name in ("images", "depth", "masks"))
    largest = max(view.depth[view.known].max(initial=0) for view in views) or 1.0
    # Millimetres where 16 bits hold that.
    step = max(1e-3, float(largest) / 65535)
    exact = ".exr"
    if find_spec("OpenEXR") is None:
        exact = ".tif"
    finish = Finish("picture.png").measured(views[0].picture)
    for name, picture, depth, _, known, _ in views:
        write_finished(images / f"{name}.png", picture, finish)
        write_picture(masks / (name + mask), np.where(known, np.uint8(255), np.uint8(0)))
        whole = np.rint(np.minimum(np.where(known, depth / step, 0), 65535))
        write_picture(distances / f"{name}.png", whole.astype(np.uint16))
        write_picture(distances / (name + exact), np.where(known, depth, np.float32(np.inf)))
    return step


def _write_text(path: Path, text: str) -> None:
    with atomic_write(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def _write_nerfstudio(folder: Path, views: list[_Posed], rig: ViewRig) -> None:
    """`transforms.json`: axes x right, y up, z backwards, pixel (0, 0) from 0 to 1."""
    step = _write_files(folder, views, _MASKS["nerfstudio"])
    frames = []
    names = ("fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "p1", "p2")
    for name, _, _, camera, _, centre in views:
        x, y, z = camera.position.tolist()
        lens = (*camera.focal, *centre, *camera.size, *camera.distortion)
        frames.append(
            {
                "file_path": f"images/{name}.png",
                "depth_file_path": f"depth/{name}.png",
                "mask_path": f"masks/{name}.png",
                **dict(zip(names, lens, strict=True)),
                "transform_matrix": [[1, 0, 0, x], [0, 1, 0, -y], [0, 0, 1, -z], [0, 0, 0, 1]],
            }
        )
    model = {
        "camera_model": "OPENCV",
        "unit": rig.unit,
        "depth_unit_scale_factor": step,
        "frames": frames,
    }
    _write_text(folder / "transforms.json", json.dumps(model, indent=1))


def _write_colmap(folder: Path, views: list[_Posed], rig: ViewRig) -> None:
    """`sparse/0` as text: axes x right, y down, z forward, pixel (0, 0) from 0 to 1."""
    step = _write_files(folder, views, _MASKS["colmap"])
    _write_fusion_maps(folder / "stereo", views)
    points, colours, pixels = _tracks(views)
    seen = np.isfinite(pixels[..., 0])
    # Each picture counts the points that it shows, from 0.
    order = (np.cumsum(seen, axis=1).T - 1).tolist()
    cameras = []
    images = []
    lines = []
    for number, view in enumerate(views, 1):
        camera = view.camera
        kind = "PINHOLE"
        lens = [*camera.size, *camera.focal, *view.centre]
        if any(camera.distortion):
            kind = "OPENCV"
            lens += camera.distortion
        cameras.append(f"{number} {kind} {_numbers(lens)}")
        shown = np.flatnonzero(seen[number - 1])
        where = np.column_stack([pixels[number - 1, shown] + 0.5, shown + 1]).tolist()
        images.append(f"{number} 1 0 0 0 {_numbers(-camera.position)} {number} {view.name}.png")
        images.append(" ".join(f"{x:.4f} {y:.4f} {point:.0f}" for x, y, point in where))
    for point, (place, colour) in enumerate(zip(points.tolist(), colours.tolist(), strict=True)):
        track = []
        for image in np.flatnonzero(seen[:, point]).tolist():
            track += [image + 1, order[point][image]]
        row = (point + 1, *place, *colour, rig.error, *track)
        lines.append(_numbers(row, ".9g"))
    # Programs that read models look into the first folder, stereo fusion into the second.
    for sparse in (make_folder(folder / "sparse" / "0", parents=True), folder / "sparse"):
        for name, text in (("cameras", cameras), ("images", images), ("points3D", lines)):
            _write_text(sparse / f"{name}.txt", "\n".join(text))
    _write_text(folder / "depth" / "unit.txt", f"16-bit files times {step:.9g} {rig.unit}")


def _numbers(values: Iterable[float], digits: str = ".12g") -> str:
    return " ".join(format(value, digits) for value in values)


def _write_fusion_maps(folder: Path, views: list[_Posed]) -> None:
    """Depth and normals of the views as `colmap stereo_fusion` reads them.

    OutputError if maps of other views are there.

    Stereo fusion knows no distortion: for cameras that have some, nothing is written.
    """
    if any(any(view.camera.distortion) for view in views):
        for maps in ("depth_maps", "normal_maps"):
            refuse_leftovers(folder / maps, _VIEW_FILES, [])
        return
    depths = make_folder(folder / "depth_maps", parents=True)
    normals = make_folder(folder / "normal_maps")
    for view in views:
        name = view.name + _MAPS
        _write_matrix(depths / name, np.where(view.known, view.depth, 0)[None])
        _write_matrix(normals / name, np.where(view.known, _normals(view), 0))
    _write_text(folder / "fusion.cfg", "\n".join(f"{view.name}.png" for view in views))


def _write_matrix(path: Path, planes: Array) -> None:
    """Write (channels, h, w) values as COLMAP's `Mat<float>`: sizes as text, then planes."""
    channels, height, width = planes.shape
    with atomic_write(path) as temporary:
        temporary.write_bytes(
            f"{width}&{height}&{channels}&".encode() + planes.astype("<f4").tobytes()
        )


def _normals(view: _Posed) -> Floats:
    """(3, h, w) unit normals of the surface, towards the camera, in axes of the camera."""
    rows, columns = np.indices(view.depth.shape)
    pixels = np.column_stack([columns.ravel(), rows.ravel()])
    rays = view.camera.rays(pixels).reshape(*view.depth.shape, 3)
    points = rays * np.where(view.known, view.depth, np.nan)[..., None]
    down, right = np.gradient(points, axis=(0, 1))
    normals = np.cross(down, right)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    # Beside pixels of unknown depth the surface is taken to face the camera.
    normals = np.where(length > 0, normals, -rays)
    return np.moveaxis(normals / np.linalg.norm(normals, axis=-1, keepdims=True), -1, 0)


def _tracks(views: list[_Posed]) -> tuple[Floats, NDArray[np.uint8], Floats]:
    """Points (n, 3) of the scene, their colours (n, 3), and where the views see them.

    One of 4 x 4 pixels of the middle view becomes a point.

    The last, (views, n, 2) [px], is NaN where a view sees something else at the place of the
    point, by its depth, or nothing.
    """
    middle = views[len(views) // 2]
    v, u = np.multiply(_TRACK_STEP, np.nonzero(middle.known[::_TRACK_STEP, ::_TRACK_STEP]))
    rays = middle.camera.rays(np.column_stack([u, v]))
    points = rays * middle.depth[v, u].astype(float)[:, None] + middle.camera.position
    places = np.array([view.camera.position for view in views])
    reach = float(np.ptp(places, axis=0).max()) * middle.camera.focal[0]
    pixels = np.full((len(views), len(points), 2), np.nan)
    for view, found in zip(views, pixels, strict=True):
        at = view.camera.project(points)
        inside = np.flatnonzero((at > -0.5).all(1) & (at < np.array(view.camera.size) - 0.5).all(1))
        column, row = np.rint(at[inside]).astype(int).T
        distance = points[inside, 2] - view.camera.position[2]
        # The same depth: it would move by less than half a pixel from the first view to the last.
        same = np.abs(1 / view.depth[row, column] - 1 / distance) * reach < 0.5
        shown = inside[same & view.known[row, column]]
        found[shown] = at[shown]
    colours = to_display(middle.picture)[v, u].reshape(len(u), -1)
    colours = np.broadcast_to(colours, (len(u), 3))
    several = np.isfinite(pixels[..., 0]).sum(0) > 1
    return points[several], colours[several], pixels[:, several]


def _write_rvs(folder: Path, views: list[_Posed], rig: ViewRig) -> None:
    """`cameras.json`: axes x forward, y left, z up; depth as disparity of 16 bits."""
    cameras: list[Entries] = []
    written: list[str] = []
    finish = Finish("picture.yuv").measured(views[0].picture)
    for number, (_, picture, depth, camera, known, centre) in enumerate(views):
        texture = yuv_frame(finish.apply(picture).image, "yuv420p10")
        width, height, (x, y, z) = texture.width, texture.height, camera.position.tolist()
        near, far = (1.0, 2.0)
        if known.any():
            near, far = np.quantile(depth[known], (0, 1 - _RARE)).tolist()
        near *= 1 - _RARE
        far *= 1 + _RARE
        disparity = (1 / np.where(known, depth, far) - 1 / far) / (1 / near - 1 / far)
        whole = np.rint(np.clip(disparity, 0, 1) * 65535).astype("<u2")[:height, :width]
        grey = np.full(width * height // 2, _GREY, "<u2")
        planes = {
            "texture": (10, frame_bytes(texture)),
            "depth": (16, whole.tobytes() + grey.tobytes()),
        }
        for kind, (bits, data) in planes.items():
            path = folder / f"v{number:02d}_{kind}_{width}x{height}_yuv420p{bits}le.yuv"
            written.append(path.name)
            with atomic_write(path) as temporary:
                temporary.write_bytes(data)
        cameras.append(
            {
                "Name": f"v{number:02d}",
                "Position": [z, -x, -y],
                "Rotation": [0.0, 0.0, 0.0],
                "Depthmap": 1,
                "Background": 0,
                "Depth_range": [near, far],
                "Resolution": [width, height],
                "Projection": "Perspective",
                "Focal": camera.focal,
                "Principle_point": centre,
                "BitDepthColor": 10,
                "BitDepthDepth": 16,
                "ColorSpace": "YUV420",
                "DepthColorSpace": "YUV420",
            }
        )
    refuse_leftovers(folder, r"v\d{2,}_(texture|depth)_.+\.yuv", written)
    model = {
        "Version": "2.0",
        "Content_name": folder.name,
        "Fps": 1,
        "Frames_number": 1,
        "Informative": {"Converted_by": "lfrender", "Unit": rig.unit},
        "cameras": cameras,
    }
    _write_text(folder / "cameras.json", json.dumps(model, indent=1))


#: Writers by the name of the program.
POSE_FORMATS: dict[str, Callable[[Path, list[_Posed], ViewRig], None]] = {
    "nerfstudio": _write_nerfstudio,
    "colmap": _write_colmap,
    "rvs": _write_rvs,
}
