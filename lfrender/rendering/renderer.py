"""Drawing pictures: what the kernels of blending read is prepared once, and any part is drawn from
the flat it needs.

Kernels work in the coordinates of the whole flat and picture, so that a picture has the same bits
in one part or many.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lfcal import Calibration, LensBlur
from lfcal.runtime.light.tone import is_encoded

from ..data.rendering import Part, PictureGrid, convert_to_dtype
from ..data.surface import Surface, edge_step, sample_surface_at
from ..detail.blur import shows_both_modes, squares_to_average
from ..detail.filters import DetailFilters, make_filters
from ..detail.restore import HALO, choose_filters, find_places, restore_detail
from ..flat.gray_flat import white_level
from ..flat.lens_type_weights import WEIGHT_RATIOS
from .blend.blend_pixels import blend_pixels
from .blend.blend_rows import blend_rows
from .blend.lit_flat import LitFlat, light_flat
from .blend.records import ONE_SAMPLE, Flat, Grid, Lenses, Output, Weighting, tabulate_lenses
from .warped_surface import Viewpoint

__all__ = ["AGREEMENT", "REACH", "REFOCUS_REACH", "VIEW_REACH", "Renderer"]

#: Lenses farther from a scene point add little but blur [pitch].
REACH = 1.7
#: The same of views off the middle: farther lenses see the place from other viewpoints [pitch].
VIEW_REACH = 1.3
#: The same of `refocus`, the widest blur: as many lenses as the kernel mixes [pitch].
REFOCUS_REACH = 3.0
#: Difference from the mean colour at which a lens counts a quarter [white]; ghosts exceed it.
AGREEMENT = 0.2


# No mask: all pixels of a part are drawn.
_ALL = np.empty((0, 0), bool)


@dataclass(frozen=True)
class Renderer:
    """Draws a picture."""

    calibration: Calibration
    surface: Surface
    scale: float  # output pixels per pitch
    # the mean over all lenses that agree on a point, or the lens alone whose centre is nearest
    blend: bool
    reach: float = REACH  # [pitch] lenses farther than this from a scene point are not read
    agreement: float = AGREEMENT
    aperture: float = 1.0  # part of the radius of microimages that is read
    viewpoint: Viewpoint = field(default_factory=Viewpoint)
    lit: LitFlat | None = None  # of the whole flat, if several pictures are drawn from it
    lens_blur: LensBlur | None = None  # of the lens types
    noise: float | None = (
        None  # [white] of the flat, as `measure_noise`: detail is restored against it
    )

    @property
    def grid(self) -> PictureGrid:
        lattice = self.calibration.lattice
        return PictureGrid(lattice.image_size, lattice.pitch, self.scale)

    @property
    def halo(self) -> int:
        """How far around a pixel of the picture others change it [px]."""
        return 0 if self.noise is None else HALO

    def required_part(self, part: Part) -> Part:
        """The part of the flat that a part of the picture is drawn from."""
        lattice = self.calibration.lattice
        beside = (
            self.reach * lattice.pitch
            + lattice.radius
            + 2 * self._aside
            + float(np.abs(self._moved).max())
        )
        # Four pixels for interpolation and its compensation.
        return self.grid.flat_part(
            self.grid.expand(part, self.halo), int(np.ceil(beside + self.grid.spacing)) + 4
        )

    def draw(
        self,
        pixels: NDArray[Any],
        corner: tuple[int, int] = (0, 0),
        part: Part | None = None,
        dtype: DTypeLike = np.float32,
    ) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Draw a part of the picture, by default all, from the part of the flat that is
        `required_part`, or more, in colour.

        `corner` are flat coordinates x, y of its first pixel, `dtype` is float32 or that of
        `pixels`. Returns the image (rows, columns, C) in the flat's units, and (rows, columns)
        bool: pixels that some lens shows.
        """
        part = part or self.grid.whole
        if self.noise is None:
            image, valid = self._blend(pixels, corner, part)
            return convert_to_dtype(image, np.dtype(dtype)), valid
        wide = left, top, _, _ = self.grid.expand(part, HALO)
        image, valid = self._blend(pixels, corner, wide)
        filters, kinds = self._filters
        places = find_places(kinds, self.surface, self.grid, wide)
        white = white_level(pixels, self.calibration)
        encoded = is_encoded(pixels.dtype, self.calibration.encoded)
        image = restore_detail(image, valid, places, filters, white, encoded, dtype)
        inside = slice(part[1] - top, part[3] - top), slice(part[0] - left, part[2] - left)
        return np.ascontiguousarray(image[inside]), np.ascontiguousarray(valid[inside])

    @cached_property
    def _filters(self) -> tuple[DetailFilters, NDArray[np.uint16]]:
        """Those of the picture, and which of them each value of its surface takes."""
        assert self.noise is not None
        sizes = self.surface.patch_size
        depths = float(sizes.min()), float(sizes.max())
        filters = make_filters(
            self.calibration,
            self.lens_blur,
            self.noise,
            self.scale,
            self.reach,
            depths,
            self._both_modes,
        )
        return filters, choose_filters(filters, self.surface, self.grid)

    def light(
        self,
        pixels: NDArray[Any],
        corner: tuple[int, int] = (0, 0),
        viewpoints: Iterable[Viewpoint] = (),
    ) -> LitFlat:
        """What a picture reads of a part of the flat, or several pictures from `viewpoints`."""
        surface = self.surface
        lattice = self.calibration.lattice
        parallax = max(
            point.max_parallax(surface, lattice) for point in (self.viewpoint, *viewpoints)
        )
        return light_flat(
            self.calibration,
            surface if self.blend else None,
            pixels,
            corner,
            self._reach + parallax,
        )

    def seen_depth(self) -> NDArray[np.float32]:
        """(rows, columns) signed patch size that each pixel of the picture shows [px]."""
        edge = edge_step(self.calibration.lattice.pitch)
        shape = self.grid.size[::-1]
        return sample_surface_at(
            self._seen_surface, edge, shape, self.grid.first + self._moved, self.grid.spacing
        )

    def _blend(
        self, pixels: NDArray[Any], corner: tuple[int, int], part: Part
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """A part of the picture."""
        lattice = self.calibration.lattice
        lit = self.lit or self.light(pixels, corner)
        lenses, order = self._lenses
        lenses = lenses._replace(edged=lit.edged[order])
        depth = self._seen_surface.patch_size, self._seen_surface.grid(edge_step(lattice.pitch))
        shape = part[3] - part[1], part[2] - part[0]
        image = np.empty((*shape, pixels.shape[2]), np.float32)
        output = Output(image, np.zeros(shape, bool), np.zeros(shape, bool))
        first = tuple((self.grid.first + self._moved).tolist())
        grid = Grid(first, self.grid.spacing, np.float32(self.scale), part[:2], _ALL)
        # Off the middle, rims often show a place alone; their last pixel mixes in light of the next
        # microimage.
        radius = self.aperture * lattice.radius - (1 if self._aside else 0)
        weighting = Weighting(
            np.float32(
                min(self._reach, VIEW_REACH * lattice.pitch) if self._aside else self._reach
            ),
            np.float32(self.aperture * lattice.radius + self._aside),
            tuple(map(np.float32, (*self.viewpoint.offset, radius * radius))),
            np.float32(
                self.agreement * white_level(pixels, self.calibration) if self.blend else 0.0
            ),
            self._squares,
        )
        flat = Flat(lit.unpacked, lit.shown, corner, lattice.image_size)
        if self._is_packable(pixels) and not self._is_coarse:
            packed = flat._replace(pixels=lit.packed)
            blend_rows(packed, lit.light, lenses, *depth, grid, weighting, output)
            grid = grid._replace(wanted=output.left)
        if not grid.wanted.size or grid.wanted.any():
            blend_pixels(flat, lit.light, lenses, *depth, grid, weighting, output)
        if self._aside and not output.valid.all():
            # At the border, some places are seen by far lenses alone.
            grid = grid._replace(wanted=~output.valid)
            weighting = weighting._replace(reach=np.float32(self._reach))
            blend_pixels(flat, lit.light, lenses, *depth, grid, weighting, output)
        elif self.aperture == 1 and not output.valid.all() and self._corner_reach > radius:
            # The corner of a cell is seen by its own lens alone.
            corners = grid._replace(wanted=~output.valid)
            nearest = weighting._replace(
                widest=np.float32(self._corner_reach),
                viewpoint=tuple(map(np.float32, (0, 0, self._corner_reach**2))),
                tolerance=np.float32(0),
            )
            own = lenses._replace(edged=np.zeros_like(lenses.edged))
            blend_pixels(flat, lit.light, own, *depth, corners, nearest, output)
        return output.image, output.valid

    def _is_packable(self, pixels: NDArray[Any]) -> bool:
        """Whether `blend_rows` reads such pixels; places in the flat are integers of 31 bits."""
        return (
            pixels.dtype.kind == "u"
            and pixels.shape[2] <= 3
            and pixels.shape[0] * pixels.shape[1] < 2**31
        )

    @property
    def _is_coarse(self) -> bool:
        """Whether most pixels are the mean of several samples, which `blend_rows` leaves out."""
        ratio = float(np.median(self.surface.patch_size[::8, ::8])) / self.calibration.lattice.pitch
        return bool(np.interp(ratio, WEIGHT_RATIOS, self._squares) > ONE_SAMPLE)

    @cached_property
    def _squares(self) -> NDArray[np.float32]:
        left = squares_to_average(
            self.calibration, self.lens_blur, WEIGHT_RATIOS, self.scale, self._both_modes
        )
        return left.astype(np.float32)

    @cached_property
    def _both_modes(self) -> bool:
        return shows_both_modes(self.surface.patch_size)

    @cached_property
    def _lenses(self) -> tuple[Lenses, NDArray[np.int64]]:
        return tabulate_lenses(self.calibration, self._reach)

    @property
    def _reach(self) -> float:
        return self.reach * self.calibration.lattice.pitch

    @cached_property
    def _corner_reach(self) -> float:
        """Distance [px] at which microimages are still read where their inscribed discs end."""
        return self.calibration.lit_reach()

    @property
    def _aside(self) -> float:
        return float(np.hypot(*self.viewpoint.offset))

    @cached_property
    def _seen_from(self) -> tuple[Surface, NDArray[np.float64]]:
        lattice = self.calibration.lattice
        return self.viewpoint.warp_surface(self.surface, lattice, edge_step(lattice.pitch))

    @property
    def _seen_surface(self) -> Surface:
        return self._seen_from[0]

    @property
    def _moved(self) -> NDArray[np.float64]:
        return self._seen_from[1]
