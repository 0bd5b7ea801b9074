"""Depth of flats too large for memory, by tiles of lenses.

What a lens is told by others comes from three sources. From lenses near to it: each tile is analysed with a halo of
lenses around it, whose answers are left to the tiles they belong to. From all lenses, which is the noise and the depths
that occur: from windows spread over the flat, looked at first. And from the scene as a whole, where it is one plane:
that is seen in the windows, and checked on every tile.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, FlatSource, Lattice

from .analysis import (
    LEAST_EVIDENCE,
    PRESETS,
    Overview,
    lens_by_lens,
    on_one_plane,
    regular_plane,
)  # fmt: skip
from .depthmap import DepthMap
from .flat_parts import FlatParts
from .neighbours import lens_grid, lens_halves
from .plane import TEXTURED, Plane, fit_plane
from .radiance import GrayFlat, gray_flat
from .region import lattice_of
from .search import Matcher, Preset
from .single_plane import plane_evidence
from .skipping import Shortcuts
from .spreading import grid_shape
from .surface import Surface
from .texture import blank_lenses, find_texture, noise_of, quick_statistics, untouched_texture

__all__ = ["analyze_large"]

# Lenses so many pitches around a tile are analysed with it: shading is averaged over 4.2, support fades over the rest.
_HALO = 8.0
# Bytes that a tile may take, and what it takes for each pixel: as read, in grey, without shading, smoothed, and masks.
_BUDGET, _PER_PIXEL = 6e8, 26
# Windows along each axis, their side [pitches and px], and how far inside them lenses are believed [pitches].
_WINDOWS, _WINDOW, _INSIDE = 6, (16.0, 256), 3.0
# Cells of the surface's grid among which one is looked for that begins where a block of pixels does.
_CELLS = 40


@dataclass(frozen=True)
class _Part:
    """A part of the flat to be analysed alone: its lattice, the lenses it answers for, and where both are in the whole.

    Parameters
    ----------
    corner : (2,) int64 [px]
    lattice : Lattice
        In its own pixels.
    inside : (m,) bool
        Lenses of `lattice` to answer for.
    core : (left, top, right, bottom) [px]
        What they cover of the flat.
    """

    corner: NDArray[np.int64]
    lattice: Lattice
    inside: NDArray[np.bool_]
    core: tuple[float, ...]

    @classmethod
    def of(cls, lattice: Lattice, low: Iterable[int], high: Iterable[int], core: NDArray[np.float64]) -> _Part:
        corner, end = np.array(list(low), np.int64), np.array(list(high), np.int64)
        sub = lattice_of(lattice, corner, end)
        centres = sub.centres() + corner
        return cls(corner, sub, ((centres >= core[0]) & (centres < core[1])).all(1), tuple(core.ravel().tolist()))

    @property
    def rectangle(self) -> tuple[int, int, int, int]:
        """`left, top, right, bottom` of its pixels."""
        x, y = self.corner.tolist()
        width, height = self.lattice.image_size
        return x, y, x + width, y + height


def analyze_large(
    source: FlatSource,
    calibration: Calibration,
    preset: str = "balanced",
    *,
    skip: bool | Iterable[str] = True,
    tile: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> DepthMap:
    """Estimate the depth of a flat that need not fit into memory; as `analyze`, with nearly the same answers.

    Parameters
    ----------
    source : FlatSource
        From `lfcal.open_flat`.
    calibration, preset, skip
        As in `analyze`.
    tile : int or None [px of the flat]
        Side of the tiles; None leaves it to the memory they take.
    progress : callable or None
        Called with the number of finished tiles and of all.

    Returns
    -------
    DepthMap

    Raises
    ------
    FlatError, CalibrationError, ValueError
        As `analyze`.
    """
    if preset not in PRESETS:
        raise ValueError(f"preset must be one of {', '.join(PRESETS)}, got {preset!r}")
    shortcuts = Shortcuts.of(skip)
    parts = FlatParts(source, calibration)
    look = _Look(parts, calibration)
    overview, plane, sure = _overview(look, preset, shortcuts)
    tiles = list(_tiles(calibration.lattice, tile, PRESETS[preset]))
    if plane is not None:
        depth = _checked_plane(look, tiles, plane, sure, preset, overview)
        if depth is not None:
            return depth
    return _by_tiles(look, tiles, preset, shortcuts, overview, progress)


class _Look:
    """Reads parts of the flat in grey."""

    def __init__(self, parts: FlatParts, calibration: Calibration) -> None:
        self.parts, self.calibration, self.lattice = parts, calibration, calibration.lattice

    def at(self, many: list[_Part]) -> Iterator[tuple[_Part, GrayFlat]]:
        pixels = self.parts.ahead(part.rectangle for part in many)
        for part, (_, some) in zip(many, pixels, strict=True):
            yield part, gray_flat(some, replace(self.calibration, lattice=part.lattice))


def _overview(look: _Look, preset: str, shortcuts: Shortcuts) -> tuple[Overview, Plane | None, float]:
    """What windows of the flat tell of all of it; the plane that it may be, and how sure its lenses are."""
    lattice = look.lattice
    windows = list(_windows(lattice))
    raw, rough, clear = [], [], []
    for part, gray in look.at(windows):
        plain = quick_statistics(gray)
        texture = find_texture(gray, part.lattice, plain)
        raw.append(plain.roughness[part.inside])
        rough.append(texture.statistics.roughness[part.inside])
        clear.append(texture.clear[part.inside])
    overview = Overview(
        noise_of(np.concatenate(rough)), np.zeros(0, np.float32),
        noise_of(np.concatenate(raw)),
    )  # fmt: skip
    thorough = Shortcuts(blank=shortcuts.blank, ranges=False, plane=False, still=False)
    centres, sizes, sure = [], [], []
    for part, gray in look.at(windows):
        depth = _part_depth(part, gray, preset, thorough, overview)
        found = part.inside & (depth.reason == 0)
        centres.append(part.lattice.centres()[found] + part.corner)
        sizes.append(depth.patch_size[found])
        sure.append(depth.confidence[found])
    overview = replace(overview, sizes=np.concatenate(sizes))
    plane = None
    if shortcuts.plane and np.mean(np.concatenate(clear)) >= TEXTURED:
        plane = fit_plane(np.concatenate(centres), overview.sizes.astype(np.float64), lattice.pitch)
    return overview, plane, float(np.median(np.concatenate(sure))) if len(overview.sizes) else 0.0


def _windows(lattice: Lattice) -> Iterator[_Part]:
    """Windows evenly spread from border to border."""
    size = lattice.image_size
    side = int(max(_WINDOW[0] * lattice.pitch, _WINDOW[1]))
    starts: list[list[int]] = []
    sides: list[int] = []
    for length in size:
        count = int(np.clip(length // side, 1, _WINDOWS))
        starts.append(np.linspace(0, max(0, length - side), count).astype(int).tolist())
        sides.append(side if count > 1 else length)
    for y in starts[1]:
        for x in starts[0]:
            end = min(x + sides[0], size[0]), min(y + sides[1], size[1])
            margin = _INSIDE * lattice.pitch
            # The border of the flat is none of the window's making.
            low = np.array([at + margin if at > 0 else -1.0 for at in (x, y)])
            high = np.array([at - margin if at < n else n + 1.0 for at, n in zip(end, size, strict=True)])
            yield _Part.of(lattice, (x, y), end, np.stack([low, high]))


def _tiles(lattice: Lattice, tile: int | None, setting: Preset) -> Iterator[_Part]:
    """The flat cut into tiles, each with its halo."""
    # Blocks of pixels are averaged for the search, and rows of them left out: those of the whole flat.
    block = max(1, round(lattice.pitch / setting.search_pitch)) * setting.row_step
    size = lattice.image_size
    halo = int(np.ceil(_HALO * lattice.pitch))
    if tile is None:
        tile = max(2 * halo, int(np.sqrt(_BUDGET / _PER_PIXEL)) - 2 * halo)
    edges = [np.linspace(0, length, -(-length // tile) + 1).round().astype(int).tolist() for length in size]
    spacing = grid_shape(lattice, setting.cells)[2]
    for top, bottom in zip(edges[1], edges[1][1:], strict=False):
        for left, right in zip(edges[0], edges[0][1:], strict=False):
            low = [_start(max(0, at - halo), spacing, block) for at in (left, top)]
            high = [min(n, at + halo) for n, at in zip(size, (right, bottom), strict=True)]
            yield _Part.of(lattice, low, high, np.array([(left, top), (right, bottom)]) - 0.5)


def _start(at: int, spacing: float, block: int) -> int:
    """A pixel at or somewhat before a place where a block begins and, as nearly as may be, a cell of the surface."""
    last = int(at / spacing)
    cells = np.arange(max(0, last - _CELLS), last + 1)
    starts = cells * spacing
    pixels = np.rint(starts / block).astype(int) * block
    return int(pixels[np.abs(starts - pixels).argmin()])


def _part_depth(part: _Part, gray: GrayFlat, preset: str, shortcuts: Shortcuts, overview: Overview) -> DepthMap:
    plain = quick_statistics(gray)
    blank = (blank_lenses(plain, overview.raw_noise)[0], np.inf) if shortcuts.blank else None
    return lens_by_lens(gray, part.lattice, preset, shortcuts, plain, blank, overview=overview)


def _by_tiles(
    look: _Look,
    tiles: list[_Part],
    preset: str,
    shortcuts: Shortcuts,
    overview: Overview,
    progress: Callable[[int, int], None] | None,
) -> DepthMap:
    """The answers of all tiles put together."""
    lattice = look.lattice
    grid, least = lens_grid(lattice)
    shape, first, spacing = grid_shape(lattice, PRESETS[preset].cells)
    n = len(lattice)
    patch_size, error = np.full(n, np.nan, np.float32), np.full(n, np.inf, np.float32)
    confidence, reason, drawn = np.zeros(n, np.float32), np.ones(n, np.int8), np.zeros(n, np.float32)
    surface = np.empty(shape, np.float32)
    saved: dict[str, float] = {}
    for number, (part, gray) in enumerate(look.at(tiles)):
        depth = _part_depth(part, gray, preset, shortcuts, overview)
        i, j = (part.lattice.indices()[part.inside] - least).T
        rows = grid[j, i]
        for whole, some in (
            (patch_size, depth.patch_size), (error, depth.standard_error), (confidence, depth.confidence),
            (reason, depth.reason), (drawn, depth.drawn),
        ):  # fmt: skip
            whole[rows] = some[part.inside]
        _paste(surface, depth.surface, part, spacing, lattice.image_size)
        for name, share in depth.saved.items():
            saved[name] = saved.get(name, 0.0) + share * len(rows) / n
        if progress is not None:
            progress(number + 1, len(tiles))
    plane = None
    if shortcuts.plane:
        plane = regular_plane(lattice, patch_size, error, reason == 0, np.hstack(lens_halves(lattice)))
    if plane is not None:
        return on_one_plane(plane, lattice, preset, reason, confidence, saved)
    return DepthMap(
        patch_size, error, confidence, drawn, Surface(surface, first, spacing), lattice.pitch, lattice.image_size,
        preset, reason, saved,
    )  # fmt: skip


def _paste(whole: NDArray[np.float32], surface: Surface, part: _Part, spacing: float, size: tuple[int, int]) -> None:
    """Take the places of a tile from its own surface."""
    rows, columns = surface.patch_size.shape
    u, v = np.rint(part.corner / spacing).astype(int).tolist()
    # The grid begins at the border of the first pixel, as the tiles do.
    left, top = (int(np.ceil((at + 0.5) / spacing)) for at in part.core[:2])
    right, bottom = (
        int(np.ceil((at + 0.5) / spacing)) if at + 0.5 < length else count
        for at, length, count in zip(part.core[2:], size, whole.shape[::-1], strict=True)
    )
    at_v = np.minimum(np.arange(top, bottom) - v, rows - 1)
    at_u = np.minimum(np.arange(left, right) - u, columns - 1)
    whole[top:bottom, left:right] = surface.patch_size[at_v[:, None], at_u]


def _checked_plane(
    look: _Look, tiles: list[_Part], plane: Plane, sure: float, preset: str, overview: Overview
) -> DepthMap | None:
    """The plane as the depth of the flat, None where some lens shows something else."""
    lattice = look.lattice
    grid, least = lens_grid(lattice)
    evidence = np.zeros(len(lattice), np.float32)
    for part, gray in look.at(tiles):
        plain = quick_statistics(gray)
        texture = untouched_texture(gray, plain, overview.raw_noise)
        matcher = Matcher(texture, *lens_halves(part.lattice), PRESETS[preset])
        about = plane.at(part.lattice.centres() + part.corner).astype(np.float32)
        found = plane_evidence(matcher, texture, about, PRESETS[preset])
        if found is None:
            return None
        i, j = (part.lattice.indices()[part.inside] - least).T
        evidence[grid[j, i]] = found[part.inside]
    shown = evidence >= LEAST_EVIDENCE
    spared = 1 - len(overview.sizes) / len(lattice)
    return on_one_plane(plane, lattice, preset, np.where(shown, 0, 1), sure * shown, {"plane": max(0.0, spared)})
