"""Files of several viewpoints: a folder of pictures, a stereo pair in one picture, an animation."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lfcal import Calibration
from lfcal.runtime.eight_bit import to_eight_bits
from lfcal.runtime.output_file import atomic_write, check_folder, make_folder

from ..data.rendering import Rendering
from .formats import FORMATS, PictureError, check_format
from .metadata import EmbeddedMetadata
from .picture import check_picture, write_picture

__all__ = [
    "check_animation", "check_grid", "resize_view", "scale_for_size", "stereo_pair", "write_animation", "write_grid",
    "write_quilt",
]  # fmt: skip

_NO_METADATA = EmbeddedMetadata()


def check_grid(folder: str | os.PathLike[str], suffix: str, dtype: Any = None, inputs: Iterable[Any] = ()) -> None:
    """Raise an error if a folder of views could not be made, before the views are drawn; as `check_picture`."""
    target = check_folder(folder)
    inside = target if target.is_dir() else target.parent
    check_picture(inside / f"view{suffix}", dtype, inputs=inputs)


def write_grid(
    folder: str | os.PathLike[str],
    pictures: Iterable[Rendering],
    columns: int,
    suffix: str = ".tif",
    *,
    settings: Mapping[str, Any] | None = None,
    embedded: EmbeddedMetadata = _NO_METADATA,
) -> list[Path]:
    """Write views row by row as `row1_column1.tif` and so on.

    Parameters
    ----------
    folder : path-like
        Made where it does not exist.
    pictures : iterable of Rendering
        As `views` yields them for `grid_offsets`; one at a time is held in memory.
    columns : int
        Pictures per row.
    suffix : str
        Format of the pictures, as for `write_picture`.
    settings, embedded
        As for `write_picture`.

    Returns
    -------
    list of Path

    Raises
    ------
    OutputError, PictureError
        If the folder or a picture cannot be written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> sample = lfrender.data.house(size=(240, 180), samples=2)
    >>> flat, camera = sample.flat, sample.truth.calibration
    >>> depth = lfrender.analyze(flat, camera, "fast")
    >>> pictures = lfrender.views(flat, camera, depth, offsets=[(-4, 0), (4, 0)], scale=6)
    >>> with TemporaryDirectory() as folder:
    ...     [path.name for path in write_grid(folder, pictures, columns=2, suffix=".png")]
    ['row1_column1.png', 'row1_column2.png']
    """
    target = make_folder(folder)
    paths = []
    for index, picture in enumerate(pictures):
        row, column = divmod(index, columns)
        paths.append(target / f"row{row + 1}_column{column + 1}{suffix}")
        write_picture(paths[-1], picture, settings=settings, embedded=embedded)
    return paths


def write_quilt(
    path: str | os.PathLike[str],
    pictures: Iterable[Rendering],
    columns: int,
    rows: int,
    *,
    settings: Mapping[str, Any] | None = None,
    embedded: EmbeddedMetadata = _NO_METADATA,
) -> Path:
    """Write views from left to right as a quilt of a Looking Glass display: the first at the bottom left, row by row.

    The name gets the grid and the aspect of a view, from which players take them, such as `scene_qs8x6a1.33.png`.

    Parameters
    ----------
    path : path-like
    pictures : iterable of Rendering
        `columns * rows` of one size.
    columns, rows : int
    settings, embedded
        As for `write_picture`.

    Returns
    -------
    Path
        The file, with its full name.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> sample = lfrender.data.house(size=(240, 180), samples=2)
    >>> flat, camera = sample.flat, sample.truth.calibration
    >>> depth = lfrender.analyze(flat, camera, "fast")
    >>> pictures = lfrender.views(flat, camera, depth, offsets=[(-4, 0), (4, 0)], scale=6)
    >>> with TemporaryDirectory() as folder:
    ...     write_quilt(f"{folder}/scene.png", pictures, columns=2, rows=1).name
    'scene_qs2x1a1.32.png'
    """
    images = [picture.image for picture in pictures]
    if len(images) != columns * rows:
        raise PictureError(f"{path}: a quilt of {columns} x {rows} needs {columns * rows} views, got {len(images)}")
    lines = [np.concatenate(images[row * columns : (row + 1) * columns], axis=1) for row in reversed(range(rows))]
    height, width = images[0].shape[:2]
    target = Path(path)
    if "_qs" not in target.stem:
        target = target.with_stem(f"{target.stem}_qs{columns}x{rows}a{width / height:.2f}")
    write_picture(target, np.concatenate(lines, axis=0), settings=settings, embedded=embedded)
    return target


def scale_for_size(calibration: Calibration, size: tuple[int, int]) -> float:
    """Output pixels per pitch at which a picture has at least this width and height [px]."""
    shares = [wanted / have for wanted, have in zip(size, calibration.image_size, strict=True)]
    return min(max(shares), 4.0) * calibration.lattice.pitch


def resize_view(picture: Rendering, size: tuple[int, int]) -> Rendering:
    """A view with exactly this width and height [px]; its affine lays it over the same scene coordinates."""
    height, width = picture.image.shape[:2]
    if (width, height) == size:
        return picture
    import cv2

    across, down = width / size[0], height / size[1]
    method = cv2.INTER_AREA if min(across, down) >= 1 else cv2.INTER_CUBIC
    image = cv2.resize(picture.image, size, interpolation=method)
    valid = cv2.resize(picture.valid.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST).astype(bool)
    # Pixel u of the result lies at pixel (u + 1/2) across - 1/2 of the picture.
    matrix = np.array([[across, 0.0, across / 2 - 0.5], [0.0, down, down / 2 - 0.5], [0.0, 0.0, 1.0]])
    return replace(picture, image=image, valid=valid, affine=picture.affine @ matrix, scale=picture.scale / across)


def stereo_pair(left: Rendering, right: Rendering) -> Rendering:
    """Two views side by side, for parallel viewing: the left eye's on the left. The affine is that of the left one.

    Examples
    --------
    >>> import lfrender
    >>> sample = lfrender.data.house(size=(240, 180), samples=2)
    >>> flat, camera = sample.flat, sample.truth.calibration
    >>> depth = lfrender.analyze(flat, camera, "fast")
    >>> left, right = lfrender.views(flat, camera, depth, offsets=[(-4, 0), (4, 0)], scale=6)
    >>> left.image.shape, stereo_pair(left, right).image.shape
    ((47, 62, 3), (47, 124, 3))
    """
    image = np.concatenate([left.image, right.image], axis=1)
    return replace(left, image=image, valid=np.concatenate([left.valid, right.valid], axis=1))


def check_animation(
    path: str | os.PathLike[str], dtype: Any = None, inputs: Iterable[str | os.PathLike[str] | None] = ()
) -> None:
    """Raise an error if an animation could not be written, before its views are drawn; as `check_picture`.

    Pixels must be uint8 or uint16.
    """
    check_format(path, "animation", inputs=inputs)
    if dtype is not None and np.dtype(dtype).name not in ("uint8", "uint16"):
        raise PictureError(f"{path}: animations cannot hold {np.dtype(dtype).name} pixels; write a grid of .tif")


def write_animation(path: str | os.PathLike[str], pictures: Iterable[Rendering], *, milliseconds: int = 80) -> None:
    """Write views as GIF, animated PNG or animated WebP that repeats without end; the file appears whole or not at all.

    Parameters
    ----------
    path : path-like
        The suffix chooses the format.
    pictures : iterable of Rendering
        One per frame, uint8 or uint16, the latter written with 8 bits.
    milliseconds : int
        How long a frame is shown.

    Raises
    ------
    OutputError, PictureError
        As `check_animation`; also without any picture.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> sample = lfrender.data.house(size=(240, 180), samples=2)
    >>> flat, camera = sample.flat, sample.truth.calibration
    >>> depth = lfrender.analyze(flat, camera, "fast")
    >>> pictures = lfrender.views(flat, camera, depth, offsets=[(-4, 0), (4, 0)], scale=6)
    >>> with TemporaryDirectory() as folder:
    ...     write_animation(f"{folder}/around.gif", pictures)
    ...     Path(folder, "around.gif").exists()
    True
    """
    from PIL import Image

    check_animation(path)
    frames = []
    for picture in pictures:
        check_animation(path, picture.image.dtype)
        frames.append(Image.fromarray(np.ascontiguousarray(to_eight_bits(picture.image, picture.white))))
    if not frames:
        raise PictureError(f"{path}: an animation needs at least one picture")
    suffix = Path(path).suffix.lower()
    options: dict[str, Any] = {"lossless": False, "quality": 90} if suffix == ".webp" else {}
    if suffix == ".gif":
        # All frames share one palette: with a palette each, colours would flicker.
        colours = [frame.convert("RGB") for frame in frames]
        palette = colours[0].quantize(256)
        frames = [frame.quantize(palette=palette) for frame in colours]
    with atomic_write(path) as temporary:
        frames[0].save(
            temporary, FORMATS[suffix].animation, save_all=True, append_images=frames[1:], duration=milliseconds,
            loop=0, **options,
        )  # fmt: skip
