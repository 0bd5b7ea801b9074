"""Views with their cameras, depth and masks, in the forms of programs for many views.

nerfstudio: `transforms.json`; COLMAP: a sparse model as text, with points and the views that see each; rvs: the camera
file of MPEG's view synthesis (RVS, TMIV) with raw video. Each camera stands in the axes that its program has.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, Optics, OutputError
from lfcal.runtime.arrays import to_eight_bits
from lfcal.runtime.output_file import atomic_write, make_folder

from ..data.depth_map import DepthMap
from ..data.rendering import Rendering
from ..runtime.choices import PoseFormat
from .picture import write_picture
from .poses import Array, ViewCamera, ViewRig, view_rig
from .raw_video import check_raw_format, frame_bytes, yuv_frame

__all__ = ["POSE_FORMATS", "write_posed_views"]


@dataclass(frozen=True)
class _Posed:
    """A view as it is written: its name, picture, depth (h, w), and camera."""

    name: str
    picture: Rendering
    depth: NDArray[np.float32]
    camera: ViewCamera

    @property
    def known(self) -> NDArray[np.bool_]:
        """Pixels that were seen, at a finite distance."""
        return self.picture.valid & np.isfinite(self.depth) & (self.depth > 0)

    @property
    def centre(self) -> list[float]:
        """Principal point where pixel (0, 0) reaches from 0 to 1."""
        return [at + 0.5 for at in self.camera.principal_point]


def write_posed_views(
    folder: str | os.PathLike[str],
    kind: PoseFormat,
    views: Iterable[tuple[Rendering, NDArray[np.float32]]],
    calibration: Calibration,
    depth: DepthMap,
    offsets: list[tuple[float, float]],
    still: float,
    optics: Optics | None = None,
) -> ViewRig:
    """Write views with intrinsics, extrinsics, depth and masks; OutputError or PictureError if that fails.

    The folder is made where it does not exist; `kind` is `"nerfstudio"`, `"colmap"` or `"rvs"`. The views are as
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
        raise OutputError(f"{folder}: poses are written for {', '.join(POSE_FORMATS)}, not {kind!r}")
    if kind == "rvs":
        check_raw_format(folder, "yuv")
    target, drawn = make_folder(folder), list(views)
    affine, shape = drawn[0][0].affine, drawn[0][1].shape
    rig = view_rig(calibration, depth, offsets, affine, shape[::-1], still, optics)
    v, u = np.indices(shape)
    places = np.stack([u, v, np.ones_like(u)], -1) @ affine.T
    moved = [places + np.array(offset) * (depth.pitch / still) for offset in offsets]
    posed = [
        _Posed(f"view_{number:03d}", picture, rig.depth(number, sizes, at), rig.cameras[number])
        for number, ((picture, sizes), at) in enumerate(zip(drawn, moved, strict=True))
    ]
    POSE_FORMATS[kind](target, posed, rig)
    return rig


def _write_files(folder: Path, views: list[_Posed], mask: str) -> float:
    """Write pictures, depth and masks; returns the unit of the 16-bit depth files."""
    for name in ("images", "depth", "masks"):
        (folder / name).mkdir(exist_ok=True)
    largest = max((float(view.depth[view.known].max()) for view in views if view.known.any()), default=1.0)
    # Millimetres where 16 bits hold that.
    step = max(1e-3, largest / 65000)
    exact = ".tif" if find_spec("OpenEXR") is None else ".exr"
    for view in views:
        shown = view.picture.image
        shown = shown if shown.dtype.kind == "u" else to_eight_bits(shown, view.picture.white)
        write_picture(folder / "images" / f"{view.name}.png", shown)
        write_picture(folder / "masks" / mask.format(view.name), view.picture.valid.astype(np.uint8) * np.uint8(255))
        whole = np.minimum(np.where(view.known, view.depth / step, 0), 65535)
        write_picture(folder / "depth" / f"{view.name}.png", np.rint(whole).astype(np.uint16))
        distances = np.where(view.known, view.depth, np.inf).astype(np.float32)
        write_picture(folder / "depth" / f"{view.name}{exact}", distances)
    return step


def _write_text(path: Path, text: str) -> None:
    with atomic_write(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def _write_nerfstudio(folder: Path, views: list[_Posed], rig: ViewRig) -> None:
    """`transforms.json`: axes x right, y up, z backwards, pixel (0, 0) from 0 to 1."""
    step = _write_files(folder, views, "{}.png")
    places = {"file_path": "images", "depth_file_path": "depth", "mask_path": "masks"}
    names = ("fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "p1", "p2")
    frames = []
    for view in views:
        camera, (x, y, z) = view.camera, view.camera.position.tolist()
        files = {kind: f"{place}/{view.name}.png" for kind, place in places.items()}
        lens = dict(zip(names, (*camera.focal, *view.centre, *camera.size, *camera.distortion), strict=True))
        pose = [[1, 0, 0, x], [0, 1, 0, -y], [0, 0, 1, -z], [0, 0, 0, 1]]
        frames.append({**files, **lens, "transform_matrix": pose})
    model = {"camera_model": "OPENCV", "unit": rig.unit, "depth_unit_scale_factor": step, "frames": frames}
    _write_text(folder / "transforms.json", json.dumps(model, indent=1))


def _write_colmap(folder: Path, views: list[_Posed], rig: ViewRig) -> None:
    """`sparse/0` as text: axes x right, y down, z forward, pixel (0, 0) from 0 to 1; masks as COLMAP names them."""
    step = _write_files(folder, views, "{}.png.png")
    sparse = folder / "sparse" / "0"
    sparse.mkdir(parents=True, exist_ok=True)
    points, colours, pixels = _tracks(views)
    seen = np.isfinite(pixels[..., 0])
    # Each picture counts the points that it shows, from 0.
    order = np.cumsum(seen, axis=1) - 1
    cameras, images = [], []
    for number, view in enumerate(views, 1):
        camera, bent = view.camera, any(view.camera.distortion)
        values = " ".join(f"{v:.12g}" for v in (*camera.focal, *view.centre, *(camera.distortion if bent else ())))
        kind, place = "OPENCV" if bent else "PINHOLE", " ".join(f"{-p:.12g}" for p in camera.position)
        cameras.append(f"{number} {kind} {camera.size[0]} {camera.size[1]} {values}")
        shown = np.flatnonzero(seen[number - 1])
        where = zip((pixels[number - 1, shown] + 0.5).tolist(), shown + 1, strict=True)
        images.append(f"{number} 1 0 0 0 {place} {number} {view.name}.png")
        images.append(" ".join(f"{x:.4f} {y:.4f} {point}" for (x, y), point in where))
    lines = []
    for point, (place, colour) in enumerate(zip(points.tolist(), colours.tolist(), strict=True)):
        track = " ".join(f"{view + 1} {order[view, point]}" for view in np.flatnonzero(seen[:, point]))
        lines.append("{} {:.9g} {:.9g} {:.9g} {} {} {} {:.3g} ".format(point + 1, *place, *colour, rig.error) + track)
    for name, text in (("cameras", cameras), ("images", images), ("points3D", lines)):
        _write_text(sparse / f"{name}.txt", "\n".join(text))
    _write_text(folder / "depth" / "unit.txt", f"16-bit files times {step:.9g} {rig.unit}")


def _tracks(views: list[_Posed], step: int = 4) -> tuple[Array, NDArray[np.uint8], Array]:
    """Points (n, 3) of one of `step` x `step` pixels of the middle view, colours (n, 3), and where views see them.

    The last, (views, n, 2) [px], is NaN where the depth of a view tells that something else is seen, or nothing.
    """
    middle = views[len(views) // 2]
    v, u = (step * axis for axis in np.nonzero(middle.known[::step, ::step]))
    z = middle.depth[v, u].astype(float)[:, None]
    points = np.hstack([middle.camera.slopes(np.column_stack([u, v])) * z, z]) + middle.camera.position
    places = np.array([view.camera.position for view in views])
    reach = float(np.ptp(places, axis=0).max()) * middle.camera.focal[0]
    pixels = np.full((len(views), len(points), 2), np.nan)
    for view, found in zip(views, pixels, strict=True):
        at = view.camera.project(points)
        column, row = np.rint(at).astype(int).T
        inside = (at > -0.5).all(1) & (at < np.array(view.camera.size) - 0.5).all(1)
        column, row = column[inside], row[inside]
        distance = points[inside, 2] - view.camera.position[2]
        # The same depth: it would move by less than half a pixel from the first view to the last.
        same = np.abs(1 / view.depth[row, column] - 1 / distance) * reach < 0.5
        shown = np.flatnonzero(inside)[same & view.known[row, column]]
        found[shown] = at[shown]
    image = to_eight_bits(middle.picture.image, middle.picture.white)
    colours = np.broadcast_to(image[v, u].reshape(len(u), -1), (len(u), 3))
    several = np.isfinite(pixels[..., 0]).sum(0) > 1
    return points[several], colours[several], pixels[:, several]


def _write_rvs(folder: Path, views: list[_Posed], rig: ViewRig) -> None:
    """`cameras.json`: axes x forward, y left, z up; depth as disparity of 16 bits between the depths of each view."""
    cameras: list[dict[str, Any]] = []
    for number, view in enumerate(views):
        texture = yuv_frame(view.picture.image, "yuv420p10", view.picture.white)
        width, height = texture.width, texture.height
        name, size = f"v{number:02d}", f"{width}x{height}"
        known = view.depth[view.known]
        near, far = np.quantile(known, (0, 0.999)).tolist() if known.size else (1.0, 2.0)
        near, far = 0.999 * near, 1.001 * far
        disparity = (1 / np.where(view.known, view.depth, far) - 1 / far) / (1 / near - 1 / far)
        whole = np.rint(np.clip(disparity, 0, 1) * 65535).astype("<u2")[:height, :width]
        grey = np.full(width * height // 2, 0x8000, "<u2")
        with atomic_write(folder / f"{name}_texture_{size}_yuv420p10le.yuv") as temporary:
            temporary.write_bytes(frame_bytes(texture))
        with atomic_write(folder / f"{name}_depth_{size}_yuv420p16le.yuv") as temporary:
            temporary.write_bytes(whole.tobytes() + grey.tobytes())
        x, y, z = view.camera.position.tolist()
        cameras.append(
            {"Name": name, "Position": [z, -x, -y], "Rotation": [0.0, 0.0, 0.0], "Depthmap": 1, "Background": 0}
            | {"Depth_range": [near, far], "Resolution": [width, height], "Projection": "Perspective"}
            | {"Focal": list(view.camera.focal), "Principle_point": view.centre}
            | {"BitDepthColor": 10, "BitDepthDepth": 16, "ColorSpace": "YUV420", "DepthColorSpace": "YUV420"}
        )
    about = {"Converted_by": "lfrender", "Unit": rig.unit}
    model = {"Version": "2.0", "Content_name": folder.name, "Fps": 1, "Frames_number": 1, "Informative": about}
    _write_text(folder / "cameras.json", json.dumps(model | {"cameras": cameras}, indent=1))


#: Writers by the name of the program.
POSE_FORMATS: dict[str, Callable[[Path, list[_Posed], ViewRig], None]] = {
    "nerfstudio": _write_nerfstudio, "colmap": _write_colmap, "rvs": _write_rvs,
}  # fmt: skip
