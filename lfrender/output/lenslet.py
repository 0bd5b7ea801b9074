"""Views of a grid as the flat of a regular lens array, and back, pixel by pixel.

The view in row `v` and column `u` is pixel `(u, v)` under each lens, of which there is one for each
pixel of the views.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from lfcal import Calibration, CameraFileError, FlatError, Lattice, read_flat
from lfcal.runtime.arrays import Array
from lfcal.runtime.image_formats import IMAGE_SUFFIXES

from ..runtime.types import Size
from .formats import describe_pixels

__all__ = ["lenslet_image", "lenslet_views", "read_view_grid"]

# Share of a microimage, and of a pixel, by which microimages may miss whole pixels.
_TOLERANCE = 0.25


def lenslet_image(views: ArrayLike) -> tuple[Array, Calibration]:
    """The flat of a regular lens array that shows these views, and its camera.

    Views have shape (rows, columns, h, w) or (rows, columns, h, w, 3).

    A view of row `v`, column `u` is `flat[v::rows, u::columns]`. Where things move by `d` px to the
    right from a view to the one on its right, the patch size is `1 / d` px: an HCI disparity, which
    counts to the left, is `-d`.

    Examples
    --------
    >>> flat, camera = lenslet_image(np.zeros((3, 5, 20, 30), np.uint8))
    >>> flat.shape, camera.lattice.basis.tolist()
    ((60, 150), [[5.0, 0.0], [0.0, 3.0]])
    """
    grid = np.asarray(views)
    if grid.ndim not in (4, 5) or grid.shape[4:] not in ((), (3,)) or not grid.size:
        raise FlatError(
            f"views have shape (rows, columns, h, w) or (rows, columns, h, w, 3), got {grid.shape}"
        )
    rows, columns, height, width = grid.shape[:4]
    # Row and column of a view become those within a lens.
    lenses = np.moveaxis(grid, (0, 1), (1, 3))
    flat = lenses.reshape(height * rows, width * columns, *grid.shape[4:])
    origin = np.array([columns - 1, rows - 1]) / 2
    lattice = Lattice(origin, np.diag([columns, rows]), flat.shape[1::-1], min(rows, columns) / 2)
    return np.ascontiguousarray(flat), Calibration(lattice)


def lenslet_views(flat: ArrayLike, calibration: Calibration) -> Array:
    """The views (rows, columns, h, w) or (rows, columns, h, w, 3) of a regular lens array.

    FlatError if the flat is of another size than those of the camera, CameraFileError if its
    microimages are no rectangles of whole pixels: `lfrender.views` draws views of any camera.

    Examples
    --------
    >>> views = np.arange(3 * 5 * 20 * 30).reshape(3, 5, 20, 30)
    >>> bool((lenslet_views(*lenslet_image(views)) == views).all())
    True
    """
    pixels = np.asarray(flat)
    lattice = calibration.lattice
    if pixels.shape[1::-1] != calibration.image_size:
        raise FlatError("the flat is of another size than those of the camera")
    side = np.rint(np.abs(np.diag(lattice.basis)))
    start = lattice.origin - (side - 1) / 2
    # From one border of the flat to the other.
    drift = np.abs(np.abs(lattice.basis) - np.diag(side)).max() * max(lattice.image_size)
    straight = lattice.distortion is None and drift < _TOLERANCE * side.max()
    whole = side.min() >= 1 and np.abs(start - np.rint(start)).max() < _TOLERANCE
    if not (straight and whole):
        raise CameraFileError(
            "the microimages are no rectangles of whole pixels; 'lfrender views' draws views"
        )
    columns, rows = side.astype(int)
    left, top = (np.rint(start) % side).astype(int)
    height = (pixels.shape[0] - top) // rows
    width = (pixels.shape[1] - left) // columns
    used = pixels[top : top + height * rows, left : left + width * columns]
    lenses = used.reshape(height, rows, width, columns, *pixels.shape[2:])
    return np.moveaxis(lenses, (1, 3), (0, 1))


def read_view_grid(inputs: Iterable[Path], grid: Size | None = None) -> Array:
    """Views (rows, columns, h, w) or (rows, columns, h, w, 3) from image files, or folders of them.

    With `grid`, rows and columns, they are taken row by row in the order of the numbers in their
    names; without, the last two numbers of a name are its row and column. FlatError if views are
    missing or not of one kind.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> pictures = lfrender.views(*lfrender.data.example(), offsets=[(-4, 0), (4, 0)], scale=6)
    >>> with TemporaryDirectory() as folder:
    ...     _ = lfrender.output.views.write_grid(folder, pictures, columns=2)
    ...     read_view_grid([Path(folder)]).shape
    (1, 2, 47, 62, 3)
    """
    paths: list[Path] = []
    for source in inputs:
        if source.is_dir():
            paths += [path for path in source.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES]
        else:
            paths.append(source)
    numbers = {path: [int(number) for number in re.findall(r"\d+", path.stem)] for path in paths}
    paths = sorted(numbers, key=lambda path: (numbers[path], path))
    if grid is None:
        grid, paths = _arrange(numbers)
    rows, columns = grid
    if len(paths) != rows * columns:
        raise FlatError(
            f"a grid of {rows} x {columns} needs {rows * columns} views, {len(paths)} are there"
        )
    views = [read_flat(path) for path in paths]
    first = describe_pixels(views[0])
    for path, view in zip(paths, views, strict=True):
        kind = describe_pixels(view)
        if kind != first:
            raise FlatError(
                f"{path}: is {kind}, the first is {first}; views of a grid are of one kind"
            )
    return np.stack(views).reshape(rows, columns, *views[0].shape)


def _arrange(numbers: dict[Path, list[int]]) -> tuple[Size, list[Path]]:
    """Rows and columns, and the files row by row, by the last two numbers in each name."""
    cells = {tuple(found[-2:]): path for path, found in numbers.items()}
    if not cells or min(map(len, cells)) < 2:
        raise FlatError(
            "names of views have their row and column, as row1_column1; else give --grid "
            "ROWSxCOLUMNS"
        )
    rows, columns = (sorted(set(places)) for places in zip(*cells, strict=True))
    order = list(product(rows, columns))
    problems = ["there is no view of row {}, column {}".format(*c) for c in order if c not in cells]
    if len(cells) < len(numbers):
        problems.append("several views have one row and column")
    if problems:
        raise FlatError(f"a grid of {len(rows)} x {len(columns)} views: {problems[0]}")
    return (len(rows), len(columns)), [cells[cell] for cell in order]
