"""Whether a calibration fits the pixels of a flat, measured on nine regions of it.

Camera files made by others contradict themselves at times; the pixels decide.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..camera.calibration import Calibration
from ..lattice.lattice import Lattice
from ..lattice.robust_fit import fit_affine
from ..runtime.errors import CalibrationError, FlatError

if TYPE_CHECKING:
    from ..detection.folding import TileFolds

__all__ = ["FitCheck", "check_fit"]

# A region of so many pitches holds enough lenses for a fit, and a slightly wrong angle does not smear it out.
_REGION = 13
# Regions are no smaller than this [px], nor larger than a third of the flat.
_SMALLEST = 128
# Window, in pitches, in which breaks are levelled: wider than a rim, narrower than what the scene shows in a lens.
_RIM = 0.5
_BINS = 36
# Centres a tenth of a pitch off smear the average microimage and make steps too short: they are taken in rounds, each
# from what the regions agreed on before, until that moves by less than a share of the pitch.
_PASSES = 2
_ROUNDS = 8
_SETTLED = 0.005
# Average microimages of two halves of a region correlate more than this where there are any.
_REPEATS = 0.3
_TILES = 4
# Halves of a region that place the centres further apart than this share of the pitch show no centres.
_SCATTERED = 0.05
# Centres off by less than this share of the pitch leave no mark on a picture.
_HARMLESS = 0.04
# Offsets count where they are so many times the scatter of the regions about their common trend.
_SIGNIFICANT = 2.0
# [standard deviations] from the trend, 4.685 times the median distance: regions further off have no weight.
_OUTLIER = 5.516119
_FEWEST_REGIONS = 5
# A given centre that is nearer to a gap than to a lens is further off than this share of the pitch.
_ELSEWHERE = 0.25
_NAMES = (
    ("top left corner", "middle of the top edge", "top right corner"),
    ("middle of the left edge", "middle", "middle of the right edge"),
    ("bottom left corner", "middle of the bottom edge", "bottom right corner"),
)


@dataclass(frozen=True)
class FitCheck:
    """Where the pixels put the microimages, against a given lattice.

    Parameters
    ----------
    places : (3, 3, 2) float64 [px]
        Middles of nine regions of the flat, in rows from the top.
    offset : (3, 3, 2) float64 [px]
        From the given centres to those the pixels show, at most about half a pitch; NaN where a region shows none.
    scatter : (3, 3) float64 [px]
        How far two halves of the lenses of a region differ about it.
    trend : (3, 3, 2) float64 [px]
        The shift, scale and shear that the offsets have in common, robustly: scenes mislead single regions. NaN
        where fewer than five regions show centres.
    pitch : float [px]
        Of the given lattice.
    """

    places: NDArray[np.float64]
    offset: NDArray[np.float64]
    scatter: NDArray[np.float64]
    trend: NDArray[np.float64]
    pitch: float

    @property
    def max_offset(self) -> float:
        """Longest offset of the trend [px], NaN where the pixels do not tell."""
        return float(np.linalg.norm(self.trend, axis=-1).max())

    @property
    def warning(self) -> str | None:
        """One phrase where the lattice is further off than a picture can hide, else None."""
        rest = np.linalg.norm(self.offset - self.trend, axis=-1)
        limit = _HARMLESS * self.pitch
        if np.isnan(self.max_offset) or not self.max_offset > max(limit, _SIGNIFICANT * float(np.nanmedian(rest))):
            return None
        row, column = np.unravel_index(int(np.linalg.norm(self.trend, axis=-1).argmax()), (3, 3))
        return f"the lattice is off by up to {self.max_offset:.1f} px in the {_NAMES[row][column]}"


def check_fit(calibration: Calibration, image: ArrayLike) -> FitCheck:
    """Measure on nine regions of a flat how far the centres of `calibration` are from those the pixels show.

    Parameters
    ----------
    calibration : Calibration
    image : (h, w) or (h, w, 3) array_like
        A white image or any scene capture of this camera.

    Raises
    ------
    FlatError
        If the image is not of the size the calibration is for.
    """
    flat = np.asarray(image)
    width, height = calibration.image_size
    if flat.ndim not in (2, 3) or flat.shape[:2] != (height, width):
        raise FlatError(
            f"image has shape {flat.shape}; the calibration is for flats of {width} x {height} px, give one of its size"
        )
    lattice = calibration.lattice
    side = int(max(_SMALLEST, _REGION * lattice.pitch))
    across, down = min(side, max(width // 3, 1)), min(side, max(height // 3, 1))
    corners = [
        (x, y) for y in (0, (height - down) // 2, height - down) for x in (0, (width - across) // 2, width - across)
    ]
    places = np.array(corners) + (np.array([across, down]) - 1) / 2
    regions = [_Region.of(flat[y : y + down, x : x + across], lattice, x, y) for x, y in corners]
    offset, scatter, trend = _measured(regions, places)
    gain = calibration.gain_map
    if gain is not None and len(gain.cut):
        # Cut microimages have their rims elsewhere: what the camera's own light shows there is no misfit.
        bands = {y: np.nan_to_num(gain.rows(lattice, y, down)) for _, y in corners}
        own = [_Region.of(bands[y][:, x : x + across], lattice, x, y) for x, y in corners]
        offset = offset - np.nan_to_num(_measured(own, places)[0])
        trend = _Trend.through(places, offset, scatter, trend)
    known = np.isfinite(scatter).sum() >= _FEWEST_REGIONS
    common = trend.at(places) if known else np.full((9, 2), np.nan)
    return FitCheck(
        places.reshape(3, 3, 2), offset.reshape(3, 3, 2), scatter.reshape(3, 3), common.reshape(3, 3, 2), lattice.pitch
    )


def _measured(
    regions: list[_Region], places: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], _Trend]:
    """Offsets (9, 2) of nine regions about `places` (9, 2), their scatter (9,) [px] and trend."""
    lattice = regions[4].lattice
    trend = _Trend(np.zeros(2), np.zeros((2, 2)), _elsewhere(regions) @ lattice.basis)
    for _ in range(_ROUNDS):
        measured = [region.offset(trend, at) for region, at in zip(regions, places, strict=True)]
        offset, scatter = np.array([v for v, _ in measured]), np.array([v for _, v in measured])
        before, trend = trend, _Trend.through(places, offset, scatter, trend)
        if np.abs(trend.at(places) - before.at(places)).max() < _SETTLED * lattice.pitch:
            break
    return offset, scatter, trend


@dataclass(frozen=True)
class _Trend:
    """Offset `shift + (p - middle) @ slope` [px] of the true centre near a given one at `p`."""

    middle: NDArray[np.float64]
    slope: NDArray[np.float64]
    shift: NDArray[np.float64]

    def at(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Offsets (..., 2) at `places` (..., 2) [px]."""
        return self.shift + (places - self.middle) @ self.slope

    @classmethod
    def through(
        cls, places: NDArray[np.float64], offset: NDArray[np.float64], scatter: NDArray[np.float64], before: _Trend
    ) -> _Trend:
        """Robust fit to the known rows of `offset` (9, 2) [px]; `before` where they are too few."""
        known = np.isfinite(scatter)
        if known.sum() < _FEWEST_REGIONS:
            return before
        middle = places.mean(0)
        reach = float(np.ptp(places, axis=0).max())
        design = np.column_stack([np.ones(known.sum()), (places[known] - middle) / reach])
        # Halves may agree by chance: no region is trusted beyond what is usual.
        error = scatter[known] + np.median(scatter[known]) + 1e-6
        change = fit_affine(design, offset[known], error**-2, passes=20, cutoff=_OUTLIER)[0]
        return cls(middle, change[1:] / reach, change[0])


@dataclass(frozen=True)
class _Region:
    """A part of the flat: its tones (h, w), levelled breaks (h, w), and the given lattice there."""

    picture: NDArray[np.float32]
    rims: NDArray[np.float32]
    lattice: Lattice

    @classmethod
    def of(cls, pixels: NDArray[Any], whole: Lattice, x: int, y: int) -> _Region:
        """The region whose `pixels` (h, w) or (h, w, 3) begin at `x, y` of the flat."""
        from ..images.preprocessing import edge_strength, normalise_locally, sqrt_luminance

        down, across = pixels.shape[:2]
        middle = np.array([x + (across - 1) / 2, y + (down - 1) / 2])
        index, right, low = whole.to_index(middle + np.array([[0, 0], [1, 0], [0, 1]]))
        basis = np.linalg.inv(np.array([right - index, low - index]))
        origin = middle + (np.rint(index) - index) @ basis - [x, y]
        picture = sqrt_luminance(pixels)
        rims = normalise_locally(edge_strength(picture), _RIM * whole.pitch)
        return cls(picture, rims, Lattice(origin, basis, (across, down), whole.radius))

    @cached_property
    def folds(self) -> list[TileFolds]:
        """Tones and rims, each laid over one cell."""
        from ..detection.folding import fold_tiles

        side = max(8, max(self.picture.shape) // _TILES)
        return fold_tiles([self.picture, self.rims], self.lattice.basis, side, _BINS)

    @cached_property
    def repeats(self) -> bool:
        """Whether two halves of the region show the same average rim."""
        fold = self.folds[1]
        rows, columns = np.divmod(np.arange(len(fold.centre)), fold.grid[1])
        a, b = (fold.mean((rows + columns) % 2 == colour).ravel() for colour in (0, 1))
        spread = float(a.std() * b.std())
        return spread > 0 and float(np.mean((a - a.mean()) * (b - b.mean()))) > _REPEATS * spread

    def offset(self, trend: _Trend, place: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        """From a given centre in the middle to the one the pixels show (2,) [px], and its scatter [px], or NaN.

        The search starts from the given centres moved by `trend`; the middle of the region is at `place` (2,) [px].
        """
        from ..detection.radial_profile import fit_lattice

        given = self.lattice
        middle = (np.array(given.image_size) - 1) / 2
        origin = given.origin + trend.at(given.origin - middle + place)
        start = Lattice(origin, given.basis + given.basis @ trend.slope, given.image_size, given.radius)
        nothing = np.full(2, np.nan), float("nan")
        if not self.repeats:
            return nothing
        try:
            fit = fit_lattice(self.rims, start, passes=_PASSES)
        except (CalibrationError, np.linalg.LinAlgError):
            return nothing
        if not fit.half_difference < _SCATTERED * given.pitch:
            return nothing
        index = (middle - given.origin) @ np.linalg.inv(given.basis)
        return fit.origin + index @ fit.basis - middle, fit.half_difference


def _elsewhere(regions: list[_Region]) -> NDArray[np.float64]:
    """From the given centres to those of the lenses in all regions together (2,) [cells], 0 where that is near."""
    from ..detection.cell_centre import choose_lens_centre, find_round_centres

    cells = [np.zeros((_BINS, _BINS)) for _ in range(2)]
    for region in regions:
        shift = np.rint(region.lattice.to_index(np.zeros((1, 2)))[0] * _BINS).astype(int)
        for cell, fold in zip(cells, region.folds, strict=True):
            cell += np.roll(fold.mean(), (shift[1], shift[0]), axis=(0, 1))
    basis = regions[0].lattice.basis
    if not all(cell.std() > 0 for cell in cells):
        return np.zeros(2)
    guess = choose_lens_centre(find_round_centres(cells, [1.0, 1.0], basis), cells[0] ** 2, basis)
    index = guess.position - np.rint(guess.position)
    steps = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    vectors = (index - steps) @ basis
    nearest = np.linalg.norm(vectors, axis=1).argmin()
    far = float(np.linalg.norm(vectors[nearest])) > _ELSEWHERE * float(np.sqrt(abs(np.linalg.det(basis))))
    return index - steps[nearest] if far else np.zeros(2)
