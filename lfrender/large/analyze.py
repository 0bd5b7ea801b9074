"""Depth of flats too large for memory, by tiles of lenses.

What a lens is told by others comes from three sources. From lenses near to it: each tile is analysed with a halo of
lenses around it, whose answers are left to the tiles they belong to. From all lenses, which is the noise and the depths
that occur: from windows spread over the flat, looked at first. And from the scene as a whole, where it is one plane:
that is seen in the windows, and checked on every tile.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, FlatSource, Lattice

from ..data.depth_map import DepthMap
from ..data.region import scaled
from ..data.surface import Surface
from ..depth.level_depth import on_one_plane, regular_plane
from ..depth.matching.matcher import PRESETS, Matcher
from ..depth.matching.shortcuts import Shortcuts
from ..depth.pipeline import Overview, Single, lens_by_lens
from ..depth.planes.detection import explained_by_plane, plane_evidence, with_misled
from ..depth.planes.plane_fit import TEXTURED, Plane, fit_plane
from ..depth.surface.densify import grid_shape
from ..depth.validity.classify import LEAST_EVIDENCE
from ..depth.validity.textureless import find_textureless
from ..flat.grey_flat import GrayFlat, gray_flat
from ..flat.grey_flat import lens_by_lens as uneven_lenses
from ..flat.lens_graph import lens_grid, lens_halves, neighbour_rows
from ..flat.texture import find_texture, noise_of, quick_statistics, untouched_texture
from .flat_parts import PartReader
from .tiles import LensTile, lens_tiles, lens_windows
from .workers import ClusterWorkers, LocalWorkers, Workers

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["analyze_large"]


def analyze_large(
    source: FlatSource,
    calibration: Calibration,
    preset: str = "balanced",
    *,
    skip: bool | Iterable[str] = True,
    progress: Callable[[int, int], None] | None = None,
    client: Client | None = None,
    threads: int | None = None,
) -> DepthMap:
    """Estimate the depth of a flat that need not fit into memory; as `analyze`, with nearly the same answers.

    Size, type and pitch of the flat alone tell the tiles, so that no setting, number of workers or machine changes an
    answer.

    Parameters
    ----------
    source : FlatSource
        From `lfcal.open_flat`.
    calibration, preset, skip
        As in `analyze`.
    progress : callable or None
        Called with the number of finished tiles and of all.
    client : distributed.Client or None
        Have tiles analysed by the workers of this cluster, with the same answers bit for bit. They read the flat
        themselves: it must lie on storage that all of them see under the same path.
    threads : int or None
        Threads of the kernels in each worker of a cluster; None leaves it to the machine.

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
    parts = PartReader(source, calibration)
    workers = LocalWorkers(parts) if client is None else ClusterWorkers(client, source, threads)
    whole = _Whole(calibration, preset, shortcuts)
    pixel_bytes = parts.channels * source.dtype.itemsize
    tiles = list(lens_tiles(calibration.lattice, whole.factor, PRESETS[preset], pixel_bytes))
    overview, plane, sure = _overview(whole, workers)
    whole = replace(whole, overview=overview)
    depth = None if plane is None else _checked_plane(whole, workers, tiles, plane, sure)
    if depth is None:
        depth = _by_tiles(whole, workers, tiles, progress)
    return scaled(depth, calibration.lattice, whole.factor)


@dataclass(frozen=True)
class _Whole:
    """What the parts of a flat are told of all of it."""

    calibration: Calibration
    preset: str
    shortcuts: Shortcuts
    overview: Overview = Overview(0.0, np.zeros(0, np.float32), 0.0)  # noqa: RUF009 (nobody writes into it)

    @property
    def factor(self) -> int:
        """How many pixels of the flat, each way, become one for the analysis."""
        return PRESETS[self.preset].factor(self.calibration.lattice.pitch)

    @cached_property
    def lattice(self) -> Lattice:
        """In pixels of the flat as it is analysed."""
        lattice = self.calibration.lattice
        return lattice if self.factor == 1 else lattice.downscaled(self.factor)

    @cached_property
    def _gain(self) -> Any:
        return self.calibration.part_gain() if uneven_lenses(self.calibration) else None

    def gray(self, part: LensTile, pixels: NDArray[Any]) -> GrayFlat:
        """A part of the flat as it is analysed, its light corrected as that of the whole."""
        height, width = pixels.shape[:2]
        light = None if self._gain is None else self._gain.at(*part.rectangle[:2], width, height)
        return gray_flat(pixels, replace(self.calibration, lattice=part.full), part.factor, light)


def _seen(
    whole: _Whole, part: LensTile, pixels: NDArray[Any]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Roughness of the lenses of a window, with and without what they have in common; which clearly have texture."""
    gray = whole.gray(part, pixels)
    plain = quick_statistics(gray)
    texture = find_texture(gray, part.lattice, plain)
    here = part.inside
    return plain.roughness[here], texture.statistics.roughness[here], texture.clear[here]


def _depths(
    whole: _Whole, part: LensTile, pixels: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.float32]]:
    """Place, patch size and confidence of the lenses of a window that are resolved."""
    depth, single = _part_depth(whole, part, pixels)
    found = part.inside & (depth.reason == 0)
    sizes = single.patch_size[found].astype(np.float32)
    return part.lattice.centres()[found] + part.corner, sizes, depth.confidence[found]


def _part_depth(whole: _Whole, part: LensTile, pixels: NDArray[Any]) -> tuple[DepthMap, Single]:
    """The depth of the lenses of a part, and of those around them; what single ones say."""
    gray = whole.gray(part, pixels)
    plain = quick_statistics(gray)
    blank = None
    if whole.shortcuts.blank:
        blank = find_textureless(gray, part.lattice, plain, PRESETS[whole.preset], whole.overview.raw_noise)
    return lens_by_lens(gray, part.lattice, whole.preset, whole.shortcuts, plain, blank, overview=whole.overview)


def _plane_evidence(
    whole: _Whole, item: tuple[LensTile, Plane], pixels: NDArray[Any]
) -> tuple[NDArray[np.float32], NDArray[Any]] | None:
    """How well the lenses of a part match on a plane, and how much of their texture that explains; None where some show
    something else."""
    part, plane = item
    gray = whole.gray(part, pixels)
    plain = quick_statistics(gray)
    texture = untouched_texture(gray, plain, whole.overview.raw_noise)
    matcher = Matcher(texture, *lens_halves(part.lattice), PRESETS[whole.preset])
    about = plane.at(part.lattice.centres() + part.corner).astype(np.float32)
    found = plane_evidence(matcher, texture, about, PRESETS[whole.preset])
    if found is None:
        return None
    explained = explained_by_plane(matcher, texture, about, found)
    return found[part.inside], explained[part.inside & texture.clear]


def _overview(whole: _Whole, workers: Workers) -> tuple[Overview, Plane | None, float]:
    """What windows of the flat tell of all of it; the plane that it may be, and how sure its lenses are."""
    windows = list(lens_windows(whole.calibration.lattice, whole.factor))
    rectangles = [part.rectangle for part in windows]
    raw, rough, clear = map(np.concatenate, zip(*workers.each(_seen, whole, windows, rectangles), strict=True))
    overview = Overview(noise_of(rough), np.zeros(0, np.float32), noise_of(raw))
    thorough = Shortcuts(blank=whole.shortcuts.blank, ranges=False, plane=False, still=False)
    looking = replace(whole, shortcuts=thorough, overview=overview)
    centres, sizes, sure = map(np.concatenate, zip(*workers.each(_depths, looking, windows, rectangles), strict=True))
    overview = replace(overview, sizes=sizes)
    plane = None
    if whole.shortcuts.plane and np.mean(clear) >= TEXTURED:
        plane = fit_plane(centres, sizes.astype(np.float64), whole.lattice.pitch)
    return overview, plane, float(np.median(sure)) if len(sizes) else 0.0


def _by_tiles(
    whole: _Whole, workers: Workers, tiles: list[LensTile], progress: Callable[[int, int], None] | None
) -> DepthMap:
    """The answers of all tiles put together."""
    lattice, preset = whole.lattice, whole.preset
    grid, least = lens_grid(lattice)
    shape, first, spacing = grid_shape(lattice, PRESETS[preset].cells)
    n = len(lattice)
    patch_size, error = np.full(n, np.nan, np.float32), np.full(n, np.inf, np.float32)
    confidence, reason, drawn = np.zeros(n, np.float32), np.ones(n, np.int8), np.zeros(n, np.float32)
    single = Single(np.full(n, np.nan, np.float32), np.full(n, np.inf, np.float32), np.full(n, np.inf))
    surface = np.empty(shape, np.float32)
    saved: dict[str, float] = {}
    found = workers.each(_part_depth, whole, tiles, [part.rectangle for part in tiles])
    for number, (part, (depth, own)) in enumerate(zip(tiles, found, strict=True)):
        i, j = (part.lattice.indices()[part.inside] - least).T
        rows = grid[j, i]
        for into, some in (
            (patch_size, depth.patch_size), (error, depth.standard_error), (confidence, depth.confidence),
            (reason, depth.reason), (drawn, depth.drawn), (single.patch_size, own.patch_size),
            (single.standard_error, own.standard_error), (single.astray, own.astray),
        ):  # fmt: skip
            into[rows] = some[part.inside]
        _paste(surface, depth.surface, part, spacing)
        for name, share in depth.saved.items():
            saved[name] = saved.get(name, 0.0) + share * len(rows) / n
        if progress is not None:
            progress(number + 1, len(tiles))
    plane = None
    if whole.shortcuts.plane:
        plane = regular_plane(
            lattice.centres(),
            n,
            lattice.pitch,
            single.patch_size,
            single.standard_error,
            reason,
            single.astray,
            neighbour_rows(lattice, lattice.steps),
        )
    if plane is not None:
        return on_one_plane(plane, lattice, preset, reason, confidence, saved)
    return DepthMap(
        patch_size, error, confidence, drawn, Surface(surface, first, spacing), lattice.pitch, lattice.image_size,
        preset, reason, saved,
    )  # fmt: skip


def _paste(whole: NDArray[np.float32], surface: Surface, part: LensTile, spacing: float) -> None:
    """Take the places of a tile from its own surface."""
    rows, columns = surface.patch_size.shape
    u, v = np.rint(part.corner / spacing).astype(int).tolist()
    # The grid begins at the border of the first pixel, as the tiles do.
    left, top = (int(np.ceil((at + 0.5) / spacing)) for at in part.core[:2])
    right, bottom = (
        int(np.ceil((at + 0.5) / spacing)) if np.isfinite(at) else count
        for at, count in zip(part.core[2:], whole.shape[::-1], strict=True)
    )
    at_v = np.minimum(np.arange(top, bottom) - v, rows - 1)
    at_u = np.minimum(np.arange(left, right) - u, columns - 1)
    whole[top:bottom, left:right] = surface.patch_size[at_v[:, None], at_u]


def _checked_plane(
    whole: _Whole, workers: Workers, tiles: list[LensTile], plane: Plane, sure: float
) -> DepthMap | None:
    """The plane as the depth of the flat, None where some lens shows something else."""
    lattice = whole.lattice
    grid, least = lens_grid(lattice)
    evidence = np.zeros(len(lattice), np.float32)
    explained: list[NDArray[Any]] = []
    items = [(part, plane) for part in tiles]
    checked = workers.each(_plane_evidence, whole, items, [part.rectangle for part in tiles])
    for part, found in zip(tiles, checked, strict=True):
        if found is None:
            return None
        i, j = (part.lattice.indices()[part.inside] - least).T
        evidence[grid[j, i]] = found[0]
        explained.append(found[1])
    plane = with_misled(plane, np.concatenate(explained))
    shown = evidence >= LEAST_EVIDENCE
    spared = 1 - len(whole.overview.sizes) / len(lattice)
    reason = np.where(shown, 0, 1)
    return on_one_plane(plane, lattice, whole.preset, reason, sure * shown, {"plane": max(0.0, spared)})
