"""Model of a white image: discs of one radial profile, each with its own gain, cut by a second disc (cat-eye).

Away from the optical axis a stop in front of or behind the main lens' pupil cuts microimages to lens shapes. The cut
is a disc too, and its place relative to the microimage changes with the place in the field.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from ..lattice.cell import clip_rows, is_outside_cell
from .cut_kernel import accumulate_cut
from .edge_profile import edge_blur, edge_depths
from .whole_kernel import accumulate_whole, by_ring, thinned

__all__ = ["LOCAL_PARAMETERS", "Microimages", "NormalEquations", "build_normal_equations", "find_edge", "mean_profile"]

# Parameters of a single lens: place (2), displacement of the cutting disc (2), its radius, the blur both edges share,
# the gain.
LOCAL_PARAMETERS = 7
# Those of a lens that nothing cuts: place and gain.
_WHOLE = 3
_CHUNKS = 64
# Share of the steepest slope of the profile above which it is an edge.
_STEEP = 0.1
# Weights of steps and of bends of the profile against that of the pixels.
_STIFF, _SMOOTH = 1e-4, 0.3
# Share of the pixels of a ring that must see it before it moves freely.
_SLOW = 0.01
# The even inside of a microimage is thinned where its radius is at least this [px], up to so far [px] from its edge.
_LARGE = 3.0
_MARGIN = 0.5


@dataclass(frozen=True)
class Microimages:
    """Lenses to be compared with the model, and the model.

    Parameters
    ----------
    light : (n, k, k) float32
        Squares of the flat around the lenses.
    corners : (n, 2) int64 [px]
        Flat coordinates of the first pixel of each.
    centres, cut : (n, 2) float64 [px]
        Microimage centres and displacements of the cutting discs from them.
    gain, trust : (n,) float64
        Light of each lens over that of the profile, and its weight in the fit.
    tilt : (n, 2) float64 [1/px]
        Relative change of the gain within the microimage.
    radius, soft : float [px]
        Of the cutting disc and of its edge (standard deviation); `soft` is 0 where there is no such disc.
    faces : (k, 2) float64 [1/px]
        `delta @ face <= 0.5` inside the cell of a lens.
    inner, reach : float [px]
        Radii of the circles inside and around the cell.
    step : float [px]
        Between samples of the profile.
    level, weight : (r,) float64
        Profile and inverse variance of its pixels at radii `0, step, 2*step...`.
    four : (r,) float64
        Amplitude of `cos(4 * angle)` added to the profile: square pixels soften an edge along their sides otherwise
        than across their corners.
    edge : (r,) bool
        Where the profile falls from the disc into the gap (`find_edge`).
    shared : float
        Correlation of the blur of the two edges where they run alike, 0..1.
    dark : float
        Light where the cutting disc lets none through.
    full : float
        Light from which on pixels are clipped: there may have been any amount more.
    """

    light: NDArray[np.float32]
    corners: NDArray[np.int64]
    centres: NDArray[np.float64]
    cut: NDArray[np.float64]
    gain: NDArray[np.float64]
    trust: NDArray[np.float64]
    tilt: NDArray[np.float64]
    radius: float
    soft: float
    faces: NDArray[np.float64]
    inner: float
    reach: float
    step: float
    level: NDArray[np.float64]
    weight: NDArray[np.float64]
    four: NDArray[np.float64]
    edge: NDArray[np.bool_]
    shared: float
    dark: float
    full: float

    @cached_property
    def steps(self) -> NormalEquations:
        """Least squares about this model."""
        return build_normal_equations(self)

    @cached_property
    def depths(self) -> NDArray[np.float64]:
        """(r,) normal score of the profile, see `edge_depths`."""
        return edge_depths(self.level, self.edge, self.dark, self.step)

    @cached_property
    def blur(self) -> tuple[float, float] | None:
        """Blur of the edge of the microimages and its shape, None where they show none; see `edge_blur`."""
        return edge_blur(self.depths, self.edge, self.step)

    @property
    def whole(self) -> bool:
        """Whether no disc cuts the microimages."""
        return not self.soft > 0

    @property
    def plain(self) -> bool:
        """Whether no disc cuts the microimages and none of their pixels is clipped: gains from cores are right."""
        return self.whole and not np.isfinite(self.full)


@dataclass(frozen=True)
class NormalEquations:
    """Least squares of all lenses about the present model, the profile included.

    Parameters
    ----------
    normal, right : (n, 7, 7), (n, 7) float64
        Normal matrix and right side of the local parameters, the gain last; where nothing is cut these are but three.
    mixed : (n, 7 or 1, r) float64
        Part of the normal matrix between local parameters and the profile; only of the gains where nothing is cut,
        since whole microimages move without their profile.
    profile, force : (r, r), (r,) float64
        Part of the profile over all lenses; as `mixed`, `four` and `variance` without meaning where only places were
        asked for.
    four : (r,) float64
        Step of `Microimages.four`.
    variance : (r,) float64
        Mean squared residual over the radius, without outliers.
    scatter : (n,) float64
        Mean of the weighted squared residuals of each lens, outliers at their limit, its `trust` left out.
    cost : float
        Mean of `scatter` over all pixels.
    """

    normal: NDArray[np.float64]
    right: NDArray[np.float64]
    mixed: NDArray[np.float64]
    profile: NDArray[np.float64]
    force: NDArray[np.float64]
    four: NDArray[np.float64]
    variance: NDArray[np.float64]
    scatter: NDArray[np.float64]
    cost: float


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def _accumulate_level(light, corners, centres, gain, faces, inner, reach, step, chunks, total, count):
    lenses, side = light.shape[0], light.shape[1]
    for chunk in prange(chunks):
        for lens in range(chunk * lenses // chunks, (chunk + 1) * lenses // chunks):
            cx, cy = centres[lens, 0] - corners[lens, 0], centres[lens, 1] - corners[lens, 1]
            top, bottom = clip_rows(cy, reach, 0, side)
            for y in range(top, bottom):
                dy = y - cy
                left, right = clip_rows(cx, np.sqrt(max(reach * reach - dy * dy, 0.0)), 0, side)
                for x in range(left, right):
                    dx = x - cx
                    rho = np.sqrt(dx * dx + dy * dy)
                    if rho > inner and is_outside_cell(dx, dy, faces):
                        continue
                    place = rho / step
                    ring = int(place)
                    part = place - ring
                    value = light[lens, y, x] / gain[lens]
                    total[chunk, ring] += (1 - part) * value
                    total[chunk, ring + 1] += part * value
                    count[chunk, ring] += 1 - part
                    count[chunk, ring + 1] += part


def find_edge(level: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(r,) where a profile falls from the disc into the gap."""
    slope = -np.gradient(level)
    core = float(np.median(level[: max(2, len(level) // 2)]))
    half = 0.5 * (core + float(np.quantile(level, 0.1)))
    crossing = int(np.argmax(level < half))
    near = np.s_[max(crossing - 2, 0) : crossing + 2]
    gentle = np.flatnonzero(slope < _STEEP * slope[near].max())
    edge = np.ones(len(level), dtype=bool)
    edge[: gentle[gentle < crossing - 1].max(initial=-1) + 1] = False
    edge[gentle[gentle > crossing].min(initial=len(level)) :] = False
    return edge


def _calm(discs: Microimages) -> float:
    """Radius [px] inside of which a microimage is so even that every few pixels say as much about it as all."""
    radius = int(np.argmax(discs.edge)) * discs.step - _MARGIN
    return radius if radius > _LARGE else 0.0


def mean_profile(discs: Microimages) -> NDArray[np.float64]:
    """(r,) mean profile of the lenses, whatever cuts them."""
    total, count = np.zeros((_CHUNKS, len(discs.level))), np.zeros((_CHUNKS, len(discs.level)))
    _accumulate_level(
        discs.light, discs.corners, discs.centres, discs.gain, discs.faces, discs.inner, discs.reach, discs.step,
        _CHUNKS, total, count,
    )  # fmt: skip
    seen = np.flatnonzero(count.sum(0) > 0)
    mean: NDArray[np.float64] = np.interp(np.arange(len(discs.level)), seen, total.sum(0)[seen] / count.sum(0)[seen])
    return mean


def build_normal_equations(discs: Microimages, learn: bool = True) -> NormalEquations:
    """Gauss-Newton steps of all local parameters of all lenses, over every pixel of their cells.

    Of whole microimages, which move without their profile, the profile need not be learnt.

    Raises
    ------
    LinAlgError
        If the model has run away: it is not finite, or explains no pixel.
    """
    known = (discs.centres, discs.cut, discs.gain, discs.trust, discs.tilt, discs.level, discs.weight, discs.four)
    if not all(np.isfinite(values).all() for values in (*known, discs.radius, discs.soft, discs.dark)):
        raise np.linalg.LinAlgError("the model of the microimages is not finite")
    lenses, rings = len(discs.centres), len(discs.level)
    learn = learn or not discs.whole
    own = _WHOLE if discs.whole else LOCAL_PARAMETERS
    normal, right = np.zeros((lenses, own, own)), np.zeros((lenses, own))
    mixed = np.zeros((lenses if learn else 0, 1 if discs.whole else LOCAL_PARAMETERS, rings))
    band, scatter = np.zeros((_CHUNKS, rings, 11 if discs.whole else 8)), np.zeros((lenses, 2))
    slope = np.gradient(discs.level, discs.step)
    calm = _calm(discs)
    tables = np.column_stack([discs.level, slope, discs.weight, discs.four])
    if not discs.whole:
        steep = discs.blur[1] if discs.blur else 0.0
        accumulate_cut(
            discs.light, discs.corners, discs.centres, discs.cut, discs.gain, discs.trust, discs.tilt, discs.radius,
            discs.soft, discs.faces, discs.inner, discs.reach, discs.step, np.column_stack([tables, discs.depths]),
            discs.edge, calm, *thinned(calm), discs.shared, steep, discs.dark, discs.full, _CHUNKS, normal, right,
            mixed, band, scatter,
        )  # fmt: skip
    else:
        accumulate_whole(
            discs.light, discs.corners, discs.centres, discs.gain, discs.trust, discs.tilt, discs.faces, discs.inner,
            discs.reach, discs.step, tables, calm, *thinned(calm), discs.full, _CHUNKS, learn, normal, right, mixed,
            band, scatter,
        )  # fmt: skip
    for row in range(1, own):
        normal[:, row, :row] = normal[:, :row, row]
    misfit, number = scatter.sum(0)
    spread, cost = scatter[:, 0] / np.maximum(scatter[:, 1], 1), float(misfit / max(number, 1))
    if not learn:
        if not (normal[:, 0, 0] > 0).any():
            raise np.linalg.LinAlgError("the model of the microimages explains no pixel")
        none = np.zeros(0)
        return NormalEquations(normal, right, mixed, none, none, none, none, spread, cost)
    rows = by_ring(band.sum(0)) if discs.whole else band.sum(0)
    main, side, force, total, turned, turned_own, squares, count = rows.T
    if not (main > 0).any():
        raise np.linalg.LinAlgError("the model of the microimages explains no pixel")
    # Rings that hardly a pixel fell into are like their neighbours; where lenses lie alike to the pixels, only the
    # smoothness of the profile tells where between the pixels an edge is.
    stiff = float(np.median(main[main > 0])) * _stiffness(rings)
    profile = np.diag(main) + np.diag(side[:-1], 1) + np.diag(side[:-1], -1) + stiff
    # Rings that hardly any light reaches through the cutting disc move slowly.
    profile += _SLOW * np.diag(total)
    settled = turned_own + _SLOW * (total + max(float(np.median(total)), 1e-30))
    return NormalEquations(
        normal, right, mixed, profile, force - stiff @ discs.level, turned / settled, _smooth_variance(squares, count),
        spread, cost,
    )  # fmt: skip


@lru_cache(8)
def _stiffness(rings: int) -> NDArray[np.float64]:
    """(r, r) weights of steps and bends of a profile."""
    flat, bend = np.diff(np.eye(rings), axis=0), np.diff(np.eye(rings), 2, axis=0)
    stiff: NDArray[np.float64] = _STIFF * flat.T @ flat + _SMOOTH * bend.T @ bend
    stiff.flags.writeable = False
    return stiff


def _smooth_variance(squares: NDArray[np.float64], count: NDArray[np.float64]) -> NDArray[np.float64]:
    """(r,) mean square; few pixels say little about their spread, so neighbouring rings are taken together."""
    near = np.ones(5)
    total, number = np.convolve(squares, near, "same"), np.convolve(count, near, "same")
    overall = total.sum() / max(number.sum(), 1)
    variance: NDArray[np.float64] = (total + 10 * overall) / (number + 10)
    return variance
