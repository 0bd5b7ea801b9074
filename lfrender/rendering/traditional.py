"""The traditional picture of a plenoptic camera: one pixel per microlens."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration
from lfcal.runtime.checks import find_depth_doubt
from lfcal.runtime.fastmath import FAST, square
from lfcal.runtime.kernels.jit import kernel

from ..data.depth_map import REASONS, DepthMap
from ..data.rendering import Rendering, finish_picture
from ..depth.same_surface import TOLERANCE, same_surface
from ..flat.gray_flat import correction_tables, has_uneven_lenses
from ..flat.lens_graph import lens_grid
from ..flat.validation import check_flat
from .settings import DEFAULT, RenderSettings

__all__ = ["TOO_LITTLE", "find_depth_problem", "resolves_too_little", "traditional"]

#: What is said where the traditional picture is drawn instead of one in focus; takes the name of the option.
TOO_LITTLE = (
    "next to no lenses are resolved that form a surface: drawn is the traditional picture, one pixel per microlens; "
    "with {}, the picture in focus"
)


# Neighbours of the same depth that a lens on a surface has, of at most six.
_ON_SURFACE, _MOST_NEIGHBOURS = 3, 6


@kernel(share=lambda flat, centres, *_: len(centres), fastmath=FAST)
def _lens_means(begin, end, flat, centres, radius, gains, gain_step, unlit, out, lit):
    """Mean of each microimage over the pixels that are not `unlit` ((0, 0): all are lit), and how many those are."""
    height, width, channels = flat.shape
    last = len(gains) - 1
    known = unlit.size > 0
    for lens in range(begin, end):
        cx, cy = centres[lens, 0], centres[lens, 1]
        count = 0
        for k in range(channels):
            out[lens, k] = 0.0
        for y in range(max(0, int(np.ceil(cy - radius))), min(height - 1, int(np.floor(cy + radius))) + 1):
            half = np.sqrt(max(0.0, radius * radius - (y - cy) * (y - cy)))
            for x in range(max(0, int(np.ceil(cx - half))), min(width - 1, int(np.floor(cx + half))) + 1):
                if known and unlit[y, x]:
                    continue
                gain = gains[min(int((square(x - cx) + square(y - cy)) / gain_step), last)]
                for k in range(channels):
                    out[lens, k] += gain * np.float32(flat[y, x, k])
                count += 1
        for k in range(channels):
            out[lens, k] /= max(count, 1)
        lit[lens] = count


def find_depth_problem(depth: DepthMap, settings: RenderSettings = DEFAULT) -> str | None:
    """Why a depth map shows no scene: next to no lens has a depth, or few of those that have form surfaces.

    On a surface are lenses with three neighbours of the same depth; single ones are chance. The traditional picture is
    then all that a flat has to give.
    """
    analysed = np.asarray(depth.reason) != REASONS.index("not analysed")
    share = float((depth.mode[analysed] != 0).mean()) if analysed.any() else 0.0
    if share > settings.mostly_resolved or depth.centres is None:
        return find_depth_doubt(1 - share, share, share)
    from scipy.spatial import cKDTree

    resolved = depth.mode != 0
    sizes, centres = depth.patch_size[resolved], depth.centres[resolved]
    reach = settings.neighbour_reach * depth.pitch
    on_surface = 0.0
    if len(sizes) > _ON_SURFACE:
        near = cKDTree(centres).query(centres, _MOST_NEIGHBOURS + 1, distance_upper_bound=reach)[1][:, 1:]
        beside = np.append(sizes, np.nan)[near]
        alike = same_surface(beside, sizes[:, None], TOLERANCE * depth.pitch).sum(1)
        on_surface = float((alike >= _ON_SURFACE).sum()) / float(analysed.sum())
    return find_depth_doubt(1 - share, share, on_surface)


def resolves_too_little(depth: DepthMap) -> bool:
    """Whether `find_depth_problem` finds one."""
    return find_depth_problem(depth) is not None


def traditional(flat: NDArray, calibration: Calibration) -> Rendering:
    """One pixel per microlens: the mean of its microimage (Lumsdaine and Georgiev 2008, section 3).

    On a lattice that is not the pixel grid, each pixel is interpolated between the lenses around it.

    Parameters
    ----------
    flat : (H, W) or (H, W, C) array
    calibration : Calibration

    Returns
    -------
    Rendering
        At one output pixel per pitch.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal import Calibration, Lattice
    >>> camera = Calibration(Lattice([10, 10], [[20, 0], [0, 20]], (400, 300), 9))
    >>> flat = np.full((300, 400), 100, np.uint8)
    >>> traditional(flat, camera).image.shape
    (15, 20)
    """
    pixels = check_flat(flat, calibration)
    lattice = calibration.lattice
    (gains, *_), gain_step = correction_tables(calibration)
    unlit = np.empty((0, 0), bool)
    if has_uneven_lenses(calibration, types=True):
        unlit = np.isnan(calibration.gain())
        pixels, gains = calibration.flatten(pixels), np.ones_like(gains)
    means = np.empty((len(lattice), pixels.shape[2]), np.float32)
    lit = np.empty(len(lattice), np.int64)
    _lens_means(pixels, lattice.centres(), lattice.radius, gains, gain_step, unlit, means, lit)
    width, height = lattice.image_size
    pitch = lattice.pitch
    columns, rows = max(1, round(width / pitch)), max(1, round(height / pitch))
    first = 0.5 * pitch - 0.5
    v, u = np.mgrid[:rows, :columns]
    points = np.stack([u, v], -1).reshape(-1, 2) * pitch + first
    image, known = _interpolate_lenses(calibration, means, lit > 0, points)
    affine = np.array([[pitch, 0.0, first], [0.0, pitch, first]])
    return finish_picture(
        image.reshape(rows, columns, -1), known.reshape(rows, columns), affine, 1.0, flat, calibration
    )  # fmt: skip


def _interpolate_lenses(
    calibration: Calibration, means: NDArray[np.float32], lit: NDArray[np.bool_], points: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Means of the `lit` lenses at scene points, linear between those of a lattice cell, the nearest at the border.

    The second array tells where there is one.
    """
    grid, low = lens_grid(calibration.lattice)
    index = calibration.lattice.to_index(points) - low
    corner = np.floor(index).astype(int)
    part = index - corner
    total: NDArray[np.float32] = np.zeros((len(points), means.shape[1]), np.float32)
    weights = np.zeros(len(points), np.float32)
    for di, dj in ((0, 0), (1, 0), (0, 1), (1, 1)):
        i, j = corner[:, 0] + di, corner[:, 1] + dj
        inside = (i >= 0) & (j >= 0) & (i < grid.shape[1]) & (j < grid.shape[0])
        lens = np.where(inside, grid[np.where(inside, j, 0), np.where(inside, i, 0)], -1)
        weight = np.abs(1 - di - part[:, 0]) * np.abs(1 - dj - part[:, 1]) + np.float32(1e-6)
        weight = np.where((lens >= 0) & lit[lens], weight, 0).astype(np.float32)
        total += weight[:, None] * means[lens]
        weights += weight
    total /= np.maximum(weights, np.float32(1e-9))[:, None]
    return total, weights > 0
