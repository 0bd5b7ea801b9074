"""Parts of a flat that are analysed: a region of interest, a tile, or what has changed in a frame.

A flat and its lattice are cropped, and the depth of the part is embedded into that of the whole.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Lattice

from ..data.depth_file import camera_digest
from ..data.depth_map import REASONS, DepthMap
from ..data.surface import Surface
from ..flat.gray_flat import GrayFlat
from ..flat.lens_graph import dilate_mask
from ..flat.neighbours import Neighbours, neighbours_of
from ..flat.texture import LensStatistics, sample_statistics

__all__ = [
    "Part",
    "WholeFlat",
    "check_region",
    "crop_lattice",
    "embed_region",
    "empty_lenses",
    "rescale_depth",
    "rows_of",
    "select_lenses",
]


def check_region(
    roi: tuple[float, float, float, float], lattice: Lattice
) -> tuple[float, float, float, float]:
    """Two opposite corners of a part of the flat as `x0 < x1`, `y0 < y1`, or a ValueError that says
    what is wrong.
    """
    try:
        corners = np.array(roi, float).reshape(2, 2)
    except (TypeError, ValueError):
        raise ValueError(f"roi must be four numbers x0, y0, x1, y1 [px], got {roi!r}") from None
    (x0, y0), (x1, y1) = np.sort(corners, axis=0).tolist()
    width, height = lattice.image_size
    if not np.isfinite(corners).all() or x0 == x1 or y0 == y1:
        raise ValueError(
            f"roi {_text(roi)} has no area: give two opposite corners, x0 y0 x1 y1 [px]"
        )
    if x1 < 0 or y1 < 0 or x0 >= width or y0 >= height:
        raise ValueError(f"roi {_text(roi)} lies outside the flat of {width} x {height} px")
    return x0, y0, x1, y1


def _text(roi: Iterable[float]) -> str:
    return " ".join(f"{value:g}" for value in roi)


def select_lenses(roi: tuple[float, float, float, float], lattice: Lattice) -> NDArray[np.bool_]:
    """(n,) bool: lenses with their centre inside `x0, y0, x1, y1` [px]; a ValueError where there is
    none.
    """
    centres = lattice.centres()
    inside = np.asarray(((centres >= roi[:2]) & (centres <= roi[2:])).all(1), bool)
    if not inside.any():
        raise ValueError(
            f"no microlens has its centre in roi {_text(roi)}: make it larger than "
            f"{lattice.pitch:.1f} px"
        )
    return inside


@dataclass(frozen=True)
class WholeFlat:
    """What the analysis of a part needs to know of the whole flat."""

    noise: float  # standard deviation of a pixel, white = 1
    sizes: NDArray[np.float32]  # (m,) [px] patch sizes of resolved lenses from all over the flat
    raw_noise: float  # as `noise`, before shading is corrected


@dataclass(frozen=True)
class Part:
    """A part of a flat to analyse, and what is known of the whole."""

    gray: GrayFlat
    lattice: Lattice
    preset: str
    whole: WholeFlat | None = None
    before: DepthMap | None = None  # of an earlier frame, in pixels of `gray`
    changed: NDArray[np.bool_] | None = None  # (n,) lenses that do not keep that depth; None: all

    @cached_property
    def updated(self) -> NDArray[np.bool_]:
        """(n,) bool: lenses to estimate."""
        return np.ones(len(self.lattice), bool) if self.changed is None else self.changed

    @cached_property
    def statistics(self) -> LensStatistics:
        """Brightness of the lenses."""
        return sample_statistics(self.gray)

    @property
    def kept_sizes(self) -> NDArray[np.float32]:
        """(n,) [px] patch sizes of lenses that keep them, NaN for those to estimate."""
        nothing = np.full(len(self.lattice), np.nan, np.float32)
        if self.before is None:
            return nothing
        return np.where(self.updated, nothing, self.before.filled_patch_size)

    @property
    def kept_resolved(self) -> NDArray[np.bool_]:
        """(n,) bool: lenses that keep a patch size that was measured."""
        if self.before is None:
            return ~self.updated
        return ~self.updated & (self.before.reason == 0)

    @property
    def neighbours(self) -> Neighbours:
        return neighbours_of(self.lattice)

    def near_updated(self, steps: int = 1) -> NDArray[np.bool_]:
        """(n,) bool: lenses to estimate, and those so many steps about them."""
        near = self.updated
        if self.changed is None:
            return near
        for _ in range(steps):
            near = dilate_mask(near, self.neighbours.all)
        return near

    def crop(self, inside: NDArray[np.bool_]) -> Part:
        """The part about the lenses `inside` (n,) and those around that support them."""
        gray = self.gray
        pitch = self.lattice.pitch
        centres = self.lattice.centres()[inside]
        size = np.array(self.lattice.image_size)
        # The reach of the shading correction. Parts end at multiples of a pitch: the next frame
        # mostly has the same part.
        around = 4.5 * pitch
        step = int(np.ceil(pitch))
        low = np.maximum(0, np.floor((centres.min(0) - around) / step) * step).astype(int)
        high = np.minimum(size, np.ceil((centres.max(0) + around) / step) * step + 1).astype(int)
        lattice = self.lattice.derived(_crop, *low.tolist(), *high.tolist())
        image = np.ascontiguousarray(gray.image[low[1] : high[1], low[0] : high[0]])
        kinds = gray.lens_type
        if kinds is not None:
            kinds = kinds[rows_of(lattice, self.lattice)]
        middles = lattice.centres().astype(np.float32)
        gray = replace(gray, image=image, centres=middles, lens_type=kinds)
        return replace(self, gray=gray, lattice=lattice)


def _crop(lattice: Lattice, left: int, top: int, right: int, bottom: int) -> Lattice:
    return crop_lattice(lattice, np.array([left, top]), np.array([right, bottom]))


def crop_lattice(lattice: Lattice, low: NDArray[np.int64], high: NDArray[np.int64]) -> Lattice:
    """The lattice of the pixels from `low` (2,) to `high` (2,), not included, in the pixels of that
    part.
    """
    distortion = lattice.distortion
    if distortion is not None:
        middle = None if distortion.middle is None else distortion.middle - low
        distortion = replace(distortion, centre=distortion.centre - low, middle=middle)
    width, height = (high - low).tolist()
    return Lattice(lattice.origin - low, lattice.basis, (width, height), lattice.radius, distortion)


def embed_region(
    depth: DepthMap, sub: Lattice, lattice: Lattice, inside: NDArray[np.bool_]
) -> DepthMap:
    """Depth of the whole flat from that of a part, whose surface it keeps; other lenses are "not
    analysed".
    """
    rows = rows_of(sub, lattice)
    chosen = inside[rows]
    filled = float(np.median(depth.filled_patch_size[chosen]))
    values = empty_lenses(len(lattice), filled, REASONS.index("not analysed"))
    for name, whole in values.items():
        whole[rows[chosen]] = getattr(depth, name)[chosen]
    x, y = (lattice.origin - sub.origin + depth.surface.first).tolist()
    surface = replace(depth.surface, first=(x, y))
    saved = {**depth.saved, "roi": 1 - float(inside.mean())}
    return DepthMap(
        **values,
        surface=surface,
        pitch=lattice.pitch,
        image_size=lattice.image_size,
        preset=depth.preset,
        saved=saved,
    )


def empty_lenses(count: int, filled: float = 0.0, reason: int = 1) -> dict[str, Any]:
    """The arrays of a depth map of so many lenses without a depth, by their names."""
    nothing = np.zeros(count, np.float32)
    return {
        "patch_size": nothing + np.float32(np.nan),
        "standard_error": nothing + np.float32(np.inf),
        "confidence": nothing,
        "filled_patch_size": nothing + np.float32(filled),
        "reason": np.full(count, reason, np.int8),
    }


def rows_of(sub: Lattice, lattice: Lattice) -> NDArray[np.int32]:
    """(m,) rows in `lattice` of the lenses of a part of it."""
    neighbours = neighbours_of(lattice)
    i, j = (sub.indices() - neighbours.low).T
    return neighbours.grid[j, i]


def rescale_depth(
    depth: DepthMap,
    lattice: Lattice,
    factor: float,
    flat_samples: NDArray[np.float32] | None = None,
) -> DepthMap:
    """The same depth in pixels `factor` times as small, those of `lattice`."""
    x, y = ((first + 0.5) * factor - 0.5 for first in depth.surface.first)
    scale = np.float32(factor)
    sizes = {
        name: scale * getattr(depth, name)
        for name in ("patch_size", "standard_error", "filled_patch_size")
    }
    surface = Surface(depth.surface.patch_size * scale, (x, y), depth.surface.spacing * factor)
    centres = lattice.centres().astype(np.float32)
    return replace(
        depth,
        **sizes,
        surface=surface,
        pitch=lattice.pitch,
        image_size=lattice.image_size,
        centres=centres,
        camera=camera_digest(lattice.image_size, lattice.pitch, centres),
        flat_samples=depth.flat_samples if flat_samples is None else flat_samples,
    )
