"""The traditional picture of a plenoptic camera: one pixel per microlens."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration
from lfcal.runtime.kernels import FAST, kernel, square

from ..data.depth_map import REASONS, DepthMap
from ..data.rendering import PictureGrid, Rendering, finish_picture
from ..depth.same_surface import TOLERANCE, same_surface
from ..flat.gray_flat import correction_tables, has_uneven_lenses
from ..flat.microimages import row_of_disc
from ..flat.neighbours import neighbours_of
from ..flat.validation import check_flat

__all__ = ["TOO_LITTLE", "find_depth_problem", "traditional"]

#: What is said where the traditional picture is drawn instead of one in focus; takes the name of
#: the option.
TOO_LITTLE = (
    "next to no lenses are resolved that form a surface: drawn is the traditional picture, one "
    "pixel per microlens; with {}, the picture in focus"
)


@kernel(share=lambda flat, unlit, centres, *_: len(centres), fastmath=FAST)
def _lens_means(begin, end, flat, unlit, centres, radius, gains, step, out, lit):
    """Mean of each microimage over the pixels that are not `unlit` ((0, 0): all are lit), and
    whether there are any.
    """
    height, width, channels = flat.shape
    known = unlit.size > 0
    last = len(gains) - 1
    for lens in range(begin, end):
        cx = centres[lens, 0]
        cy = centres[lens, 1]
        count = 0
        for k in range(channels):
            out[lens, k] = 0.0
        for y in range(
            max(0, int(np.ceil(cy - radius))), min(height - 1, int(np.floor(cy + radius))) + 1
        ):
            left, number = row_of_disc(y - cy, cx, radius, 0, width - 1)
            for x in range(left, left + number):
                if not (known and unlit[y, x]):
                    gain = gains[min(int((square(x - cx) + square(y - cy)) / step), last)]
                    for k in range(channels):
                        out[lens, k] += gain * np.float32(flat[y, x, k])
                    count += 1
        for k in range(channels):
            out[lens, k] /= max(count, 1)
        lit[lens] = count > 0


def find_depth_problem(depth: DepthMap) -> str | None:
    """Why a depth map shows no scene: next to no lens has a depth, or few of those that have form
    surfaces.
    """
    analysed = np.asarray(depth.reason) != REASONS.index("not analysed")
    share = float((depth.mode[analysed] != 0).mean()) if analysed.any() else 0.0
    if share > 0.5:
        return None  # a scene: most lenses need no closer look
    from scipy.spatial import cKDTree

    resolved = depth.mode != 0
    on_surface = share if depth.centres is None else 0.0
    if depth.centres is not None and resolved.sum() > 3:
        sizes = depth.patch_size[resolved]
        centres = depth.centres[resolved]
        # Six neighbours at most, not across the diagonal of a square.
        near = cKDTree(centres).query(centres, 7, distance_upper_bound=1.3 * depth.pitch)[1][:, 1:]
        beside = np.append(sizes, np.nan)[near]
        alike = same_surface(beside, sizes[:, None], TOLERANCE * depth.pitch).sum(1)
        on_surface = float((alike >= 3).sum()) / float(analysed.sum())
    # Of the resolved lenses, captures have 0.7 to 1 on surfaces, chance 0 to 0.1; of all lenses, a
    # scene that is one small card has 0.04, an unfocused one 0.001.
    return (
        None
        if not on_surface < max(0.02, 0.5 * share)
        else (
            f"{1 - share:.0%} of the lenses have no depth, and the others form no surface; is this "
            "a capture of a scene, and made with this camera?"
        )
    )


def traditional(flat: NDArray, calibration: Calibration) -> Rendering:
    """One pixel per microlens: the mean of its microimage (Lumsdaine and Georgiev 2008, section 3).

    `flat` is (H, W) or (H, W, C). The picture has one pixel per pitch; on a lattice that is not the
    pixel grid, each is interpolated between the lenses around it.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal import Calibration, Lattice
    >>> camera = Calibration(Lattice([10, 10], [[20, 0], [0, 20]], (400, 300), 9))
    >>> flat = np.full((300, 400), 100, np.uint8)
    >>> traditional(flat, camera).image.shape
    (15, 20)
    """
    from scipy.ndimage import map_coordinates

    pixels = check_flat(flat, calibration)
    lattice = calibration.lattice
    unlit, ((gains, *_), step) = np.zeros((0, 0), bool), correction_tables(calibration)
    if has_uneven_lenses(calibration, types=True):
        pixels, unlit = calibration.region_gain().flatten(pixels)
        gains = np.ones_like(gains)
    means = np.empty((len(lattice), pixels.shape[2]), np.float32)
    lit = np.empty(len(lattice), bool)
    _lens_means(pixels, unlit, lattice.centres(), lattice.radius, gains, step, means, lit)
    grid = PictureGrid(lattice.image_size, lattice.pitch, 1.0)
    columns, rows = grid.size
    points = (
        np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 2) * grid.spacing
        + grid.first
    )
    # Linear between the lit lenses about a place, and the nearest ones at the border.
    lenses = neighbours_of(lattice).grid
    index = (lattice.to_index(points) - neighbours_of(lattice).low).T[::-1]
    shown = (lenses >= 0) & lit[lenses]
    weight = map_coordinates(shown.astype(np.float32), index, order=1, mode="nearest")
    planes = [np.where(shown, means[lenses, k], 0) for k in range(means.shape[1])]
    image = np.stack(
        [map_coordinates(plane, index, order=1, mode="nearest") for plane in planes], -1
    )
    image /= np.maximum(weight, np.float32(1e-9))[:, None]
    known = (weight > 1e-6).reshape(rows, columns)
    return finish_picture(
        image.reshape(rows, columns, -1), known, grid.affine(), 1.0, flat, calibration
    )
