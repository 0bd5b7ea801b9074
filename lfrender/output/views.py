"""Files of several viewpoints: folders of pictures, stereo pairs, quilts, animations."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lfcal import Calibration, Lattice
from lfcal.runtime.errors import check_type
from lfcal.runtime.output_file import atomic_write, check_folder, make_folder, refuse_leftovers

from ..data.rendering import PICTURE_ADVICE, Rendering, check_pictures, pixels_between
from ..depth.region import check_region
from ..runtime.types import AnyPath, Entries, Region, Size
from .finish import Finish
from .formats import DEFAULT_QUALITY, FORMATS, PictureError, check_format
from .picture import write_finished, write_picture

__all__ = [
    "MILLISECONDS",
    "check_grid",
    "crop_view",
    "resize_view",
    "scale_for_size",
    "stereo_pair",
    "write_animation",
    "write_grid",
    "write_quilt",
]

#: How long an animation shows a picture.
MILLISECONDS = 80
# Options of `write_picture` that `Finish` holds.
_FINISHING = ("exposure", "tone", "white_balance", "quality")
# Names of the files of a grid, as a regular expression.
_GRID_FILES = r"row\d+_column\d+\.\w+"


def check_grid(folder: AnyPath, suffix: str, grid: Size | None = None, **needed: Any) -> None:
    """Raise the errors of `check_format`, for what is `needed`, if no folder of views can be made.

    Files of an earlier run that a `grid` of (rows, columns) would not replace are an OutputError.
    """
    target = check_folder(folder)
    inside = target.parent
    if target.is_dir():
        inside = target
    check_format(inside / f"view{suffix}", "picture", **needed)
    if grid is not None:
        rows, columns = grid
        refuse_leftovers(
            target, _GRID_FILES, [_grid_name(k, columns) + suffix for k in range(rows * columns)]
        )


def _grid_name(index: int, columns: int) -> str:
    return f"row{index // columns + 1}_column{index % columns + 1}"


def write_grid(
    folder: AnyPath,
    pictures: Iterable[Rendering],
    columns: int,
    suffix: str = ".tif",
    *,
    finish: Finish | None = None,
    **options: Any,
) -> list[Path]:
    """Write views, `columns` in a row, as `row1_column1.tif`, ... into a folder.

    One of the `pictures` at a time is held in memory. All have one gain and white balance, found on
    the first, with the options of `write_picture`, or of `finish` if it is given. Errors are those
    of `write_picture`, and OutputError if views of an earlier run, which these do not replace, are
    in the folder.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> pictures = lfrender.views(*lfrender.data.example(), offsets=[(-4, 0), (4, 0)], scale=6)
    >>> with TemporaryDirectory() as folder:
    ...     [path.name for path in write_grid(folder, pictures, columns=2, suffix=".png")]
    ['row1_column1.png', 'row1_column2.png']
    """
    check_type(pictures, Iterable, "pictures", "give a list of pictures")
    target = make_folder(folder)
    paths = []
    chosen = {name: options.pop(name) for name in _FINISHING if name in options}
    finish = finish or Finish(f"view{suffix}", **chosen)
    for index, picture in enumerate(pictures):
        finish = finish.measured(picture)
        paths.append(target / (_grid_name(index, columns) + suffix))
        write_finished(paths[-1], picture, finish, **options)
    refuse_leftovers(target, _GRID_FILES, [path.name for path in paths])
    return paths


def write_quilt(
    path: AnyPath,
    pictures: Iterable[Rendering],
    columns: int,
    rows: int,
    finish: Finish | None = None,
    **options: Any,
) -> str:
    """Write views from left to right as a quilt of a Looking Glass display.

    The first view is at the bottom left; others follow row by row.

    There must be `columns * rows` of one size; `options` are those of `write_picture`, except those
    of brightness and colours, which `finish` holds. Players take grid and aspect of a view from the
    end of the name, such as `_qs8x6a1.33`, which is returned.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> pictures = lfrender.views(*lfrender.data.example(), offsets=[(-4, 0), (4, 0)], scale=6)
    >>> with TemporaryDirectory() as folder:
    ...     write_quilt(f"{folder}/scene_qs2x1a1.32.png", pictures, columns=2, rows=1)
    '_qs2x1a1.32'
    """
    finish = finish or Finish(path)
    images = [picture.image for picture in finish.apply_to_all(check_pictures(pictures))]
    if len(images) != columns * rows:
        raise PictureError(
            f"{path}: a quilt of {columns} x {rows} needs {columns * rows} views, got {len(images)}"
        )
    height, width = images[0].shape[:2]
    lines = [np.hstack(images[first : first + columns]) for first in range(0, len(images), columns)]
    write_picture(path, np.vstack(lines[::-1]), quality=finish.quality, **options)
    return f"_qs{columns}x{rows}a{width / height:.2f}"


def scale_for_size(
    calibration: Calibration, size: Size | None, scale: float | None = None
) -> float | None:
    """Output pixels per pitch at which a picture has at least this width and height [px].

    Without a size it is `scale`.
    """
    if size is None:
        return scale
    share = float(np.max(np.divide(size, calibration.image_size)))
    return min(share, 4.0) * calibration.lattice.pitch


def resize_view(picture: Rendering, size: Size | None) -> Rendering:
    """A picture with exactly this width and height [px], over the same scene coordinates.

    Without a size it stays as it is.
    """
    if size is None or picture.valid.shape[::-1] == size:
        return picture
    import cv2

    across, down = np.divide(picture.valid.shape[::-1], size).tolist()
    method = cv2.INTER_CUBIC
    if min(across, down) >= 1:
        method = cv2.INTER_AREA
    image = cv2.resize(picture.image, size, interpolation=method)
    valid = cv2.resize(picture.valid.view(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    # Pixel u of the result lies at pixel (u + 1/2) across - 1/2 of the picture.
    matrix = np.array(
        [[across, 0.0, across / 2 - 0.5], [0.0, down, down / 2 - 0.5], [0.0, 0.0, 1.0]]
    )
    return replace(
        picture,
        image=image,
        valid=valid.view(bool),
        affine=picture.affine @ matrix,
        scale=picture.scale / across,
    )


def crop_view(picture: Rendering, roi: Region, lattice: Lattice) -> Rendering:
    """The part of a picture between scene coordinates x0, y0, x1, y1, at least one pixel.

    ValueError if the corners lie outside the flat.
    """
    corners = np.array(check_region(roi, lattice)).reshape(2, 2)
    corners = (corners - picture.affine[:, 2]) / np.diag(picture.affine)
    left, top, right, bottom = pixels_between(corners, picture.valid.shape[::-1])
    affine = np.column_stack([picture.affine[:, :2], picture.affine @ [left, top, 1]])
    part = np.s_[top:bottom, left:right]
    return replace(picture, image=picture.image[part], valid=picture.valid[part], affine=affine)


def stereo_pair(left: Rendering, right: Rendering) -> Rendering:
    """Two views side by side for parallel viewing; the affine is that of the left one.

    Examples
    --------
    >>> import lfrender
    >>> left, right = lfrender.views(*lfrender.data.example(), offsets=[(-4, 0), (4, 0)], scale=6)
    >>> left.image.shape, stereo_pair(left, right).image.shape
    ((47, 62, 3), (47, 124, 3))
    """
    check_type(left, Rendering, "left", PICTURE_ADVICE)
    check_type(right, Rendering, "right", PICTURE_ADVICE)
    image = np.hstack([left.image, right.image])
    return replace(left, image=image, valid=np.hstack([left.valid, right.valid]))


def write_animation(
    path: AnyPath,
    pictures: Iterable[Rendering],
    *,
    milliseconds: int = MILLISECONDS,
    finish: Finish | None = None,
) -> None:
    """Write views as endless GIF, animated PNG or WebP with 8 bits; whole or not at all.

    The suffix of `path` chooses the format; each picture is shown so many `milliseconds`. `finish`
    is what is done to all of them, by default as `write_picture` does.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> pictures = lfrender.views(*lfrender.data.example(), offsets=[(-4, 0), (4, 0)], scale=6)
    >>> with TemporaryDirectory() as folder:
    ...     write_animation(f"{folder}/around.gif", pictures)
    ...     Path(folder, "around.gif").exists()
    True
    """
    from PIL import Image

    finish = finish or Finish(path, eight_bits=True)
    check_format(path, "animation", quality=finish.quality)
    shown = finish.apply_to_all(check_pictures(pictures))
    frames = [Image.fromarray(np.ascontiguousarray(picture.image)) for picture in shown]
    if not frames:
        raise PictureError(f"{path}: an animation needs at least one picture")
    kind = FORMATS[Path(path).suffix.lower()].animation
    options: Entries = {"duration": milliseconds, "loop": 0}
    if kind == "WEBP":
        options |= {"lossless": False, "quality": finish.quality or DEFAULT_QUALITY}
    if kind == "GIF":
        # All frames share one palette: with a palette each, colours would flicker.
        palette = frames[0].convert("RGB").quantize()
        frames = [frame.convert("RGB").quantize(palette=palette) for frame in frames]
    with atomic_write(path) as temporary:
        frames[0].save(temporary, kind, save_all=True, append_images=frames[1:], **options)
