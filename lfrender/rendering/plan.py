"""A picture to be rendered: what the kernels read is prepared once, and any part is drawn from the flat it needs.

Kernels work in the coordinates of the whole flat and picture, so that a picture has the same bits in one part or many.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from ..data.surface import DepthGrid, Surface, edge_step, sample_surface_at
from ..data.viewpoint import Viewpoint
from ..detail.settings import HALO
from ..flat.distorted_lookup import lens_displacements
from ..flat.gray_flat import correction_cell, correction_tables, has_uneven_lenses, white_level
from ..flat.lens_graph import lens_offsets
from ..flat.lens_type_weights import focus_weights
from ..flat.prefilter import prefilter_flat
from ..runtime.cache import cached
from .blend.blend_pixels import Flat, Grid, Lenses, Output, Weighting, blend_pixels
from .blend.blend_rows import blend_rows
from .blend.lens_runs import SortedLenses
from .blend.lit_flat import LitFlat, light_flat
from .blend.view_rows import blend_view_rows
from .fixed_patch import covers_all_patches, render_patches
from .settings import DEFAULT

__all__ = ["Part", "RenderPlan"]

#: Columns and rows `left, top, right, bottom` of a picture or a flat [px], the last two not included.
Part = tuple[int, int, int, int]


@dataclass(frozen=True)
class RenderPlan:
    """A picture to be rendered.

    Parameters
    ----------
    calibration : Calibration
    surface : Surface
    scale : float
        Output pixels per pitch.
    blend : bool
        The mean over all lenses that agree on a point, or the lens alone whose centre is nearest.
    blur : float
        As `measure_lens_blur`.
    reach : float [pitch]
        Lenses farther than this from a scene point are not read.
    agreement : float [white]
        Difference from the mean colour at which a lens counts a quarter.
    aperture : float
        Part of the radius of microimages that is read.
    viewpoint : Viewpoint
    noise : float, optional [white]
        Of the flat, as `measure_noise`: the detail of the picture is restored.
    """

    calibration: Calibration
    surface: Surface
    scale: float
    blend: bool
    blur: float
    reach: float = DEFAULT.reach
    agreement: float = DEFAULT.agreement
    aperture: float = 1.0
    viewpoint: Viewpoint = field(default_factory=Viewpoint)
    lit: LitFlat | None = None  # of the whole flat, if several pictures are drawn from it
    noise: float | None = None

    @property
    def spacing(self) -> float:
        """Distance between output pixels [px of the flat]."""
        return self.calibration.lattice.pitch / self.scale

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows of the picture."""
        width, height = self.calibration.image_size
        return max(1, round(width / self.spacing)), max(1, round(height / self.spacing))

    @property
    def affine(self) -> NDArray[np.float64]:
        """(2, 3) from output pixel to scene coordinates."""
        first = 0.5 * self.spacing - 0.5
        return np.array([[self.spacing, 0.0, first], [0.0, self.spacing, first]])

    @cached_property
    def halo(self) -> int:
        """How far from scene points the flat is read [px]."""
        lattice = self.calibration.lattice
        aside = float(np.hypot(*self.viewpoint.offset)) + float(np.abs(self._moved).max())
        beside = self.spacing * (1 if self.noise is None else 1 + HALO)
        return int(np.ceil(self.reach * lattice.pitch + lattice.radius + 2 * aside + beside)) + DEFAULT.margin

    def required_part(self, part: Part) -> Part:
        """The part of the flat that a part of the picture is drawn from."""
        width, height = self.calibration.image_size
        first = 0.5 * self.spacing - 0.5
        low = [int(first + self.spacing * k) - self.halo for k in part[:2]]
        high = [int(np.ceil(first + self.spacing * (k - 1))) + self.halo + 1 for k in part[2:]]
        return max(0, low[0]), max(0, low[1]), min(width, high[0]), min(height, high[1])

    def expand_part(self, part: Part, halo: int) -> Part:
        """A part of the picture with `halo` pixels about it, as far as there are any."""
        columns, rows = self.size
        left, top, right, bottom = part
        return max(left - halo, 0), max(top - halo, 0), min(right + halo, columns), min(bottom + halo, rows)

    def part_of_region(self, roi: tuple[float, float, float, float]) -> Part:
        """Columns and rows of the picture whose scene points lie in `x0, y0, x1, y1`, at least one of each."""
        first = 0.5 * self.spacing - 0.5
        low = [
            min(max(int(np.ceil((at - first) / self.spacing)), 0), n - 1)
            for at, n in zip(roi[:2], self.size, strict=True)
        ]
        high = [int(np.floor((at - first) / self.spacing)) + 1 for at in roi[2:]]
        right, bottom = (min(max(end, start + 1), n) for start, end, n in zip(low, high, self.size, strict=True))
        return low[0], low[1], right, bottom

    def tiles(self, side: tuple[int, int]) -> Iterator[Part]:
        """Parts of the picture of at most `side` (columns, rows), row by row."""
        columns, rows = self.size
        for top in range(0, rows, side[1]):
            for left in range(0, columns, side[0]):
                yield left, top, min(left + side[0], columns), min(top + side[1], rows)

    def draw(
        self, pixels: NDArray[Any], corner: tuple[int, int] = (0, 0), part: Part | None = None, stored: bool = False
    ) -> tuple[NDArray, NDArray[np.bool_]]:
        """Draw a part of the picture.

        Parameters
        ----------
        pixels : (h, w, C) array
            The part of the flat that is `required_part`, or more, in colour.
        corner : (int, int) [px]
            Flat coordinates x, y of its first pixel.
        part : (left, top, right, bottom), optional
            Of the picture; by default all of it.
        stored : bool
            Round the picture to the type of `pixels`.

        Returns
        -------
        image : (rows, columns, C) float32, or of the type of `pixels`
            In the flat's units.
        valid : (rows, columns) bool
            Pixels that some lens shows.
        """
        part = part or (0, 0, *self.size)
        if self.noise is not None:
            from ..detail.draw import draw_detail

            return draw_detail(self, pixels, corner, part, pixels.dtype if stored else np.float32)
        shape = (part[3] - part[1], part[2] - part[0], pixels.shape[2])
        if not self._shows_patches:
            return self.blend_part(pixels, corner, part, np.empty(shape, pixels.dtype if stored else np.float32))
        size, first = float(np.copysign(self.scale, self.surface.patch_size[0, 0])), 0.5 * self.spacing - 0.5
        lattice = self.calibration.lattice
        return render_patches(
            pixels,
            corner,
            lattice,
            size,
            first,
            self.aperture * lattice.radius,
            self.gains[0][0],
            self.gains[1],
            part,
        )

    def render_changed(
        self, pixels: NDArray[Any], wanted: NDArray[np.bool_], image: NDArray[Any], valid: NDArray[np.bool_]
    ) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """As `draw` of the whole picture, but only the `wanted` pixels (rows, columns).

        The others are taken from an earlier picture, `image` (rows, columns, C) and `valid`.
        """
        image, valid = image.copy(), valid.copy()
        if wanted.any() and self.noise is not None:
            from ..detail.draw import draw_changed_detail

            restored, changed = draw_changed_detail(self, pixels, wanted, valid)
            np.copyto(image, restored, where=changed[..., None])
        elif wanted.any():
            self.blend_part(pixels, (0, 0), (0, 0, *self.size), image, valid, wanted)
        return image, valid

    def blend_part(
        self,
        pixels: NDArray[Any],
        corner: tuple[int, int],
        part: Part,
        image: NDArray[Any],
        valid: NDArray[np.bool_] | None = None,
        wanted: NDArray[np.bool_] | None = None,
    ) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Blend a part of the picture into `image`, rounded to its type."""
        valid = np.empty(image.shape[:2], bool) if valid is None else valid
        wanted = np.empty((0, 0), bool) if wanted is None else wanted
        # Packed pixels have three, so that flats of one use the same code.
        channels = (0,) * (3 if self._suits_rows(pixels) else pixels.shape[2])
        tolerance = np.float32(self.agreement * white_level(pixels, self.calibration) if self.blend else 0.0)
        lit = self.lit or light_flat(self, pixels, corner, wanted.size > 0)
        pixels, edged, light = lit.pixels, lit.edged, lit.light
        read = Flat(pixels, lit.shown, np.array(corner), np.array(self.calibration.image_size))
        first = 0.5 * self.spacing - 0.5 + self._moved
        grid = Grid(first, self.spacing, np.float32(self.scale), np.array(part[:2]), wanted)
        blurred, view = np.float32((self.blur * self.scale) ** 2), np.array(self.viewpoint.offset, np.float32)
        weighting = Weighting(self.reach * self.calibration.lattice.pitch, tolerance, blurred, view)
        half, top = (0.5, np.iinfo(image.dtype).max) if image.dtype.kind in "ui" else (0.0, np.inf)
        # One kernel for all types of pictures.
        output = Output(image[..., None].view(np.uint8), valid, np.float32(half), np.float32(top))
        # Only a mean over many lenses is as sharp as the flat if the blur of the interpolation is compensated.
        if not self._suits_rows(pixels):
            ready = prefilter_flat(pixels) if self.blend else pixels
        else:
            packed, left = lit.packed, np.empty(valid.shape, bool)
            words = packed.view(np.uint32).reshape(*packed.shape, -1)
            inputs = read._replace(pixels=words), light, self._sorted_lenses(edged), *self._depth, grid
            if any(self.viewpoint.offset):
                weighting = weighting._replace(
                    reach=min(weighting.reach, DEFAULT.view_reach * self.calibration.lattice.pitch)
                )
                blend_view_rows(self._view, *inputs, weighting, output, left)
            else:
                blend_rows(*inputs, weighting, output, left)
            ready, grid = packed.view(pixels.dtype).reshape(*packed.shape, 4), grid._replace(wanted=left)
        lenses, general = self._lenses, read._replace(pixels=ready)
        if not grid.wanted.size or grid.wanted.any():
            weighting = weighting._replace(reach=np.float32(weighting.reach))
            blend_pixels(channels, general, light, lenses, *self._depth, grid, weighting, output)
        if weighting.reach < np.float32(self.reach * self.calibration.lattice.pitch):
            # At the border, some places are seen by far lenses alone.
            grid = grid._replace(wanted=~valid & wanted if wanted.size else ~valid)
            weighting = weighting._replace(reach=np.float32(self.reach * self.calibration.lattice.pitch))
            blend_pixels(channels, general, light, lenses, *self._depth, grid, weighting, output)
        return image, valid

    def light_once(self, pixels: NDArray[Any], parallax: float) -> LitFlat:
        """What pictures from several viewpoints read of the flat, with their largest parallax [px]."""
        return light_flat(self, pixels, (0, 0), False, parallax)

    @property
    def _depth(self) -> tuple[NDArray[np.float32], DepthGrid]:
        return self._seen_surface.patch_size, self._seen_surface.grid(self.edge)

    @property
    def _lenses(self) -> Lenses:
        lattice = self.calibration.lattice
        return Lenses(
            lattice.origin, np.linalg.inv(lattice.basis), lattice.basis, *self._bend, *self._offsets, *self._shares,
            np.float32(self.aperture * lattice.radius), np.float32(lattice.pitch),
        )  # fmt: skip

    def _sorted_lenses(self, edged: NDArray[np.bool_]) -> SortedLenses:
        camera, lattice = self.calibration, self.calibration.lattice
        order, centres, types, tables = cached(camera, "sorted lenses", lambda: _sort_lenses(camera))
        aside = float(np.hypot(*self.viewpoint.offset))
        radius, pitch = np.float32(self.aperture * lattice.radius + aside), np.float32(lattice.pitch)
        return SortedLenses(centres, types, tables, edged[order], self._shares[1], radius, pitch)

    def _suits_rows(self, pixels: NDArray[Any]) -> bool:
        """Whether `blend_rows` can draw most pixels."""
        # Its places in the flat are integers of 31 bits.
        packable = pixels.dtype.kind == "u" and pixels.shape[2] <= 3 and pixels.shape[0] * pixels.shape[1] < 2**31
        return self.blend and self.blur == 0 and packable

    @property
    def _view(self) -> tuple[np.float32, np.float32, np.float32]:
        """The viewpoint and the squared radius of microimages; rims off the middle often show a place alone, and their
        last pixel mixes in light of the next microimage."""
        radius = self.aperture * self.calibration.lattice.radius - 1
        return np.float32(self.viewpoint.offset[0]), np.float32(self.viewpoint.offset[1]), np.float32(radius * radius)

    @cached_property
    def _shares(self) -> tuple[NDArray[np.int8], NDArray[np.float32]]:
        camera = self.calibration
        return cached(camera, "focus shares", lambda: focus_weights(camera.lens_types))

    @property
    def _shows_patches(self) -> bool:
        """Whether the picture consists of patches of the flat, pixel by pixel."""
        lattice, sizes = self.calibration.lattice, self.surface.patch_size
        if self.blend or sizes.size > 1 or lattice.distortion is not None:
            return False
        if has_uneven_lenses(self.calibration, types=True):
            return False
        if np.float32(self.scale) != abs(sizes[0, 0]) or min(lattice.image_size) < 2:
            return False
        return covers_all_patches(lattice, self.scale, self.aperture * lattice.radius)

    @property
    def edge(self) -> float:
        return edge_step(self.calibration.lattice.pitch)

    @cached_property
    def parallax(self) -> float:
        return self.viewpoint.max_parallax(self.surface, self.calibration.lattice)

    @cached_property
    def gains(self) -> tuple[NDArray[np.float32], float]:
        camera = self.calibration
        return cached(camera, "gain table", lambda: correction_tables(camera))

    @cached_property
    def _bend(self) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        return lens_displacements(self.calibration.lattice)

    @property
    def _offsets(self) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        lattice, reach = self.calibration.lattice, self.reach
        return cached(
            lattice, ("offsets", reach), lambda: lens_offsets(lattice, reach * lattice.pitch, DEFAULT.spacing_lenses)
        )

    @cached_property
    def _seen_from(self) -> tuple[Surface, NDArray[np.float64]]:
        return self.viewpoint.warp_surface(self.surface, self.calibration.lattice, self.edge)

    def seen_depth(self) -> NDArray[np.float32]:
        """(rows, columns) signed patch size that each pixel of the picture shows [px]."""
        columns, rows = self.size
        first = 0.5 * self.spacing - 0.5 + self._moved
        return sample_surface_at(self._seen_surface, self.edge, (rows, columns), first, self.spacing)

    @property
    def _seen_surface(self) -> Surface:
        return self._seen_from[0]

    @property
    def _moved(self) -> NDArray[np.float64]:
        return self._seen_from[1]


def _sort_lenses(
    calibration: Calibration,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Order of the lenses by y, their centres, types and light tables in that order; types are 0 if all count alike."""
    centres, cell = calibration.lattice.centres(), focus_weights(calibration.lens_types)[0]
    order = np.argsort(centres[:, 1], kind="stable")
    indices = calibration.lattice.indices()[order]

    def look_up(cell: NDArray[np.int8]) -> NDArray[np.int64]:
        i, j = (indices % len(cell)).T
        return cell[i, j].astype(np.int64)

    kinds = look_up(cell) if cell.size else np.zeros(len(order), np.int64)
    return order, np.ascontiguousarray(centres[order]), kinds, look_up(correction_cell(calibration))
