"""Normal equations of a Gauss-Newton step on a white image: built over all lenses, reduced, and solved robustly.

Unknowns are the global parameters (`model`), the common profile and a gain for each lens. Gains and profile are
eliminated first (Schur complement), then the global parameters are solved for with robust weights of the lenses.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from ..lattice.cell import clip_rows, is_outside_cell
from ..lattice.robust_fit import tukey_weights
from ..runtime.kernels.jit import kernel
from .edge_profile import edge_depths, estimate_edge_blur
from .kernel import Cell, Cut, Profile, Sums, Windows, accumulate, sum_by_ring
from .model import LOCAL_PARAMETERS
from .settings import PIXELS, SOLVER

__all__ = [
    "Microimages", "NormalEquations", "ReducedEquations", "build_normal_equations", "eliminate_gains", "invert_2x2",
    "mean_profile", "regularisation", "solve_robustly",
]  # fmt: skip

# Parts of the lenses that are summed in parallel: a fixed number, so that sums do not depend on that of the threads.
_CHUNKS = 64


@dataclass(frozen=True)
class Microimages:
    """Windows of the flat around `n` lenses, and the model that they are compared with: a profile of `r` rings."""

    light: NDArray[np.float32]  # (n, k, k) squares of the flat around the lenses
    corners: NDArray[np.int64]  # (n, 2) [px] flat coordinates of the first pixel of each
    centres: NDArray[np.float64]  # (n, 2) [px]
    cut_offset: NDArray[np.float64]  # (n, 2) [px] of the cutting discs from the centres
    gain: NDArray[np.float64]  # (n,) light of each lens over that of the profile
    lens_weight: NDArray[np.float64]  # (n,)
    slope: NDArray[np.float64]  # (n, 2) [1/px] relative change of the gain within the microimage
    shade: NDArray[np.float64]  # (n, 2) [1/px] the same of its own light alone, without that of neighbours
    cut_radius: float  # [px]
    cut_blur: float  # [px] standard deviation of the edge of the cutting disc, 0 if there is none
    cut_tail: float  # of that blur
    normals: NDArray[np.float64]  # (k, 2) [1/px] `delta @ normal <= 0.5` inside the cell of a lens
    inradius: float  # [px] of the circle inside the cell
    circumradius: float  # [px] of the circle around the cell
    step: float  # [px] between rings of the profile
    profile: NDArray[np.float64]  # (r,) light at radii `0, step, 2*step...`
    ring_weight: NDArray[np.float64]  # (r,) inverse variance of a pixel
    # (r,) amplitude of `cos(4 * direction)`: square pixels blur an edge along their sides unlike across their corners.
    harmonic: NDArray[np.float64]
    edge: NDArray[np.bool_]  # (r,) where the profile falls from the disc into the gap (`find_edge`)
    correlation: float  # `CatEye.correlation`
    gap: float  # light where the cutting disc lets none through
    saturation: float  # light from which on pixels are clipped

    @cached_property
    def equations(self) -> NormalEquations:
        """Normal equations about this model."""
        return build_normal_equations(self)

    @cached_property
    def depths(self) -> NDArray[np.float64]:
        """(r,) normal score of the profile (`edge_depths`)."""
        return edge_depths(self.profile, self.edge, self.gap, self.step)

    @cached_property
    def blur(self) -> tuple[float, float] | None:
        """Blur [px] and tail of the edge of the microimages (`estimate_edge_blur`)."""
        return estimate_edge_blur(self.depths, self.edge, self.step)

    @property
    def windows(self) -> Windows:
        """What kernels read of each lens."""
        return Windows(self.light, self.corners, self.centres, self.gain, self.lens_weight, self.slope, self.shade)

    @property
    def cell(self) -> Cell:
        """Cell of a lens, for kernels."""
        return Cell(self.normals, self.inradius, self.circumradius)

    @property
    def whole(self) -> bool:
        """Whether no disc cuts the microimages."""
        return not self.cut_blur > 0

    @property
    def gains_from_cores(self) -> bool:
        """Whether the mean of its core gives the gain of a lens: nothing is cut or clipped."""
        return self.whole and not np.isfinite(self.saturation)

    @property
    def own_light(self) -> NDArray[np.float64]:
        """(r,) the profile above its level at the border of the cell, as a share of the whole in the middle.

        At the border half of the light is that of a neighbour, in which it is shaded the other way: across the middle
        of a side of the cell nothing is left of the slope, towards its corners something is.
        """
        core = float(np.median(self.profile[: max(2, len(self.profile) // 2)]))
        border = self.inradius + PIXELS.border * (self.circumradius - self.inradius)
        border = float(np.interp(border / self.step, np.arange(len(self.profile)), self.profile))
        return core * np.clip((self.profile - border) / max(core - border, 1e-9 * core), 0, None)

    @property
    def radius(self) -> float:
        """Distance from the centre [px] at which the profile falls to the mean of disc and gap."""
        half = 0.5 * (float(np.median(self.profile[: max(2, len(self.profile) // 2)])) + self.gap)
        return max(int(np.argmax(self.profile < half)), 1) * self.step


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations about a model, the profile included; its parts are empty if it is not to be learnt.

    Local parameters are `p = 7`, the gain last, or 3 where nothing is cut. The positions of whole microimages are not
    correlated with their profile, so `coupling` has only the row of the gains then.
    """

    normal: NDArray[np.float64]  # (n, p, p)
    right: NDArray[np.float64]  # (n, p)
    coupling: NDArray[np.float64]  # (n, 7 or 1, r) between local parameters and the profile
    profile_normal: NDArray[np.float64]  # (r, r) of the profile over all lenses
    profile_right: NDArray[np.float64]  # (r,)
    harmonic_step: NDArray[np.float64]  # (r,) step of `Microimages.harmonic`
    variance: NDArray[np.float64]  # (r,) mean squared residual, without outliers
    scatter: NDArray[np.float64]  # (n,) mean of the weighted squared residuals, outliers at their limit
    cost: float  # the same over all pixels


@kernel(error_model="numpy", share=lambda windows, cell, step, total, *_: len(total))
def _accumulate_profile(begin, end, windows, cell, step, total, count):
    light, corners, centres, gain, _, _, _ = windows
    normals, inradius, circumradius = cell
    lenses, side, chunks = light.shape[0], light.shape[1], total.shape[0]
    for chunk in range(begin, end):
        for lens in range(chunk * lenses // chunks, (chunk + 1) * lenses // chunks):
            cx, cy = centres[lens, 0] - corners[lens, 0], centres[lens, 1] - corners[lens, 1]
            top, bottom = clip_rows(cy, circumradius, 0, side)
            for y in range(top, bottom):
                dy = y - cy
                half = np.sqrt(max(circumradius * circumradius - dy * dy, 0.0))
                left, right = clip_rows(cx, half, 0, side)
                for x in range(left, right):
                    dx = x - cx
                    rho = np.sqrt(dx * dx + dy * dy)
                    if rho > inradius and is_outside_cell(dx, dy, normals):
                        continue
                    place = rho / step
                    ring = int(place)
                    part = place - ring
                    value = light[lens, y, x] / gain[lens]
                    total[chunk, ring] += (1 - part) * value
                    total[chunk, ring + 1] += part * value
                    count[chunk, ring] += 1 - part
                    count[chunk, ring + 1] += part


def mean_profile(lenses: Microimages) -> NDArray[np.float64]:
    """(r,) mean radial profile of the lenses, cut or not."""
    rings = len(lenses.profile)
    total, count = np.zeros((_CHUNKS, rings)), np.zeros((_CHUNKS, rings))
    _accumulate_profile(lenses.windows, lenses.cell, lenses.step, total, count)
    seen = np.flatnonzero(count.sum(0) > 0)
    mean: NDArray[np.float64] = np.interp(np.arange(rings), seen, total.sum(0)[seen] / count.sum(0)[seen])
    return mean


def build_normal_equations(lenses: Microimages, learn: bool = True) -> NormalEquations:
    """Normal equations of the local parameters of all lenses, over every pixel of their cells.

    Without `learn` those of the profile are left out, which whole microimages do not need to move. Raises `LinAlgError`
    if the model is not finite, or explains no pixel.
    """
    values = (
        lenses.centres, lenses.cut_offset, lenses.gain, lenses.lens_weight, lenses.slope, lenses.shade, lenses.profile,
        lenses.ring_weight, lenses.harmonic, lenses.cut_radius, lenses.cut_blur, lenses.gap,
    )  # fmt: skip
    if not all(np.isfinite(value).all() for value in values):
        raise np.linalg.LinAlgError("the model of the microimages is not finite")
    count, rings, whole = len(lenses.centres), len(lenses.profile), lenses.whole
    learn = learn or not whole
    own = 3 if whole else LOCAL_PARAMETERS
    sums = Sums(
        np.zeros((count, own, own)),
        np.zeros((count, own)),
        np.zeros((count if learn else 0, 1 if whole else own, rings)),
        np.zeros((_CHUNKS, rings, 11 if whole else 12)),
        np.zeros((count, 2)),
    )
    cut = None if whole else _kernel_cut(lenses)
    accumulate(lenses.windows, lenses.cell, _kernel_profile(lenses), cut, learn, sums)
    normal, right, coupling, band, scatter = sums
    for row in range(1, own):
        normal[:, row, :row] = normal[:, :row, row]
    misfit, number = scatter.sum(0)
    spread, cost = scatter[:, 0] / np.maximum(scatter[:, 1], 1), float(misfit / max(number, 1))
    if not learn:
        if not (normal[:, 0, 0] > 0).any():
            raise np.linalg.LinAlgError("the model of the microimages explains no pixel")
        none = np.zeros(0)
        return NormalEquations(normal, right, coupling, none, none, none, none, spread, cost)
    main, side, force, total, turned, turned_own, squares, pixels = sum_by_ring(band.sum(0)).T
    if not (main > 0).any():
        raise np.linalg.LinAlgError("the model of the microimages explains no pixel")
    # Rings that hardly a pixel fell into follow their neighbours. Where all lenses lie alike to the pixels, only the
    # smoothness of the profile determines where between two pixels an edge is.
    stiff = float(np.median(main[main > 0])) * _stiffness(rings)
    profile = np.diag(main) + np.diag(side[:-1], 1) + np.diag(side[:-1], -1) + stiff
    # Rings that hardly any light reaches through the cutting disc move slowly.
    profile += PIXELS.ring_damping * np.diag(total)
    settled = turned_own + PIXELS.ring_damping * (total + max(float(np.median(total)), 1e-30))
    return NormalEquations(
        normal, right, coupling, profile, force - stiff @ lenses.profile, turned / settled,
        _smooth_variance(squares, pixels), spread, cost,
    )  # fmt: skip


def _kernel_profile(lenses: Microimages) -> Profile:
    """The profile, with the radius [px] up to which microimages are even, and how many pixels are enough there."""
    even = int(np.argmax(lenses.edge)) * lenses.step - PIXELS.even_margin
    even = even if even > PIXELS.even_radius else 0.0
    choices, fewest = PIXELS.thinning, PIXELS.least_even_pixels
    thin, aside = next((pair for pair in choices if np.pi * even**2 / pair[0] > fewest), choices[-1])
    slope = np.gradient(lenses.profile, lenses.step)
    rings = np.column_stack([lenses.profile, slope, lenses.ring_weight, lenses.harmonic, lenses.own_light])
    return Profile(lenses.step, rings, even, thin, aside, lenses.saturation)


def _kernel_cut(lenses: Microimages) -> Cut:
    disc = lenses.cut_offset, lenses.cut_radius, lenses.cut_blur, lenses.correlation
    return Cut(*disc, lenses.cut_tail, lenses.gap, lenses.edge, lenses.depths)


@lru_cache(8)
def _stiffness(rings: int) -> NDArray[np.float64]:
    """(r, r) weights of steps and second differences of a profile."""
    flat, bend = np.diff(np.eye(rings), axis=0), np.diff(np.eye(rings), 2, axis=0)
    stiff: NDArray[np.float64] = PIXELS.slope_weight * flat.T @ flat + PIXELS.bend_weight * bend.T @ bend
    stiff.flags.writeable = False
    return stiff


def _smooth_variance(squares: NDArray[np.float64], count: NDArray[np.float64]) -> NDArray[np.float64]:
    """(r,) mean square over five rings, shrunk to that of all by ten pixels."""
    near = np.ones(5)
    total, number = np.convolve(squares, near, "same"), np.convolve(count, near, "same")
    overall = total.sum() / max(number.sum(), 1)
    variance: NDArray[np.float64] = (total + 10 * overall) / (number + 10)
    return variance


@dataclass(frozen=True)
class ReducedEquations:
    """Normal equations without the gains, of `m = 6` local parameters, or 2 where nothing is cut.

    `coupling` still has the row of the gains: that of another parameter is its own row less its `gain_share` of the
    last one. It is empty where nothing is cut.
    """

    normal: NDArray[np.float64]  # (n, m, m)
    right: NDArray[np.float64]  # (n, m)
    gain_share: NDArray[np.float64]  # (n, m)
    coupling: NDArray[np.float64]  # (n, 7, r)
    profile_normal: NDArray[np.float64]  # (r, r)
    profile_right: NDArray[np.float64]  # (r,)

    @cached_property
    def _factors(self) -> NDArray[np.float64]:
        """Cholesky factors of the profile, used by all solutions of one step."""
        # Compiled code has loaded this module already.
        from scipy.linalg.lapack import dpotrf

        factors, failed = dpotrf(self.profile_normal, lower=1)
        if failed:
            raise np.linalg.LinAlgError("the pixels do not determine the profile of the microimages")
        return np.asarray(factors)

    def solve_profile(self, right: NDArray[np.float64]) -> NDArray[np.float64]:
        """(r, k) or (r,) steps of the profile for right sides of that shape; LinAlgError if there are none."""
        from scipy.linalg.lapack import dpotrs

        return np.asarray(dpotrs(self._factors, right, lower=1)[0])

    def append_gains(self, columns: NDArray[np.float64], half: NDArray[np.bool_] | slice) -> NDArray[np.float64]:
        """(n, m + 1, p) change of the local parameters of a part of the lenses and of the gains that follow."""
        return np.concatenate([columns, -(self.gain_share[half][:, None] @ columns)], axis=1)


def eliminate_gains(
    equations: NormalEquations, profile: NDArray[np.float64], reweight: NDArray[np.float64] | None = None
) -> ReducedEquations:
    """Schur complement of the gains; `reweight` (n,) is by what factor weights of lenses have changed since."""
    own = np.maximum(equations.normal[:, -1, -1], 1e-30)
    share = equations.normal[:, :-1, -1] / own[:, None]
    normal = equations.normal[:, :-1, :-1] - share[:, :, None] * equations.normal[:, None, :-1, -1]
    right = equations.right[:, :-1] - share * equations.right[:, [-1]]
    coupling = equations.coupling[:, : 0 if equations.coupling.shape[1] == 1 else None]
    if reweight is not None:
        normal, right = normal * reweight[:, None, None], right * reweight[:, None]
    if len(equations.profile_right) == 0:
        none = equations.profile_right
        return ReducedEquations(normal, right, share, coupling, equations.profile_normal, none)
    gain = equations.coupling[:, -1]
    even = gain / np.sqrt(own)[:, None]
    # Gains and profile share one scale: the norm of the profile is kept.
    scale = np.trace(equations.profile_normal) / (profile @ profile) * np.outer(profile, profile)
    return ReducedEquations(
        normal, right, share, coupling, equations.profile_normal - even.T @ even + scale,
        equations.profile_right - (equations.right[:, -1] / own) @ gain,
    )  # fmt: skip


def solve_robustly(
    jacobian: NDArray[np.float64],
    reduced: ReducedEquations,
    half: NDArray[np.bool_] | slice,
    before: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Change (p,) of the global parameters, covariance (p, p) and weights (n,) of a part of the lenses.

    Weights are Tukey's, of the distance of each lens from the common change. Those of all lenses `before` (n,), in
    nearly the same state, need only one pass.
    """
    columns = np.ascontiguousarray(jacobian[half])
    normal, right = reduced.normal[half], reduced.right[half]
    part = len(columns) / len(reduced.normal)
    lenses, local, globals_ = columns.shape
    inverse = invert_2x2(normal[:, :2, :2] + regularisation(normal))
    force, matter = right.reshape(-1), (normal @ columns).reshape(-1, globals_)
    if reduced.coupling.shape[1]:
        all_local = reduced.append_gains(columns, half)
        coupling = reduced.coupling[half].reshape(lenses * (local + 1), -1)
    weight = np.ones(lenses) if before is None else before[half]
    for _ in range(SOLVER.robust_passes if before is None else 1):
        weighted = (weight[:, None, None] * columns).reshape(-1, globals_).T
        information, pull = weighted @ matter, weighted @ force
        if reduced.coupling.shape[1]:
            # The profile changes along with the parameters: what it can explain is no information on them.
            joint = (weight[:, None, None] * all_local).reshape(len(coupling), -1).T @ coupling
            taken = reduced.solve_profile(joint.T).T / part
            information -= taken @ joint.T / weight.mean()
            pull -= part * taken @ reduced.profile_right
        scale = np.sqrt(np.maximum(np.diag(information), 1e-30))
        covariance = np.linalg.pinv(information / np.outer(scale, scale), rcond=1e-12) / np.outer(scale, scale)
        change = covariance @ pull
        left = right[:, :2] - (matter @ change).reshape(lenses, local)[:, :2]
        far = left[:, 0] ** 2 * inverse[:, 0, 0] + left[:, 1] ** 2 * inverse[:, 1, 1]
        far += 2 * left[:, 0] * left[:, 1] * inverse[:, 0, 1]
        weight, variance = tukey_weights(far)
    return change, covariance * variance, weight


def regularisation(normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2, 2) added to normal matrices (n, m, m) of positions, so that those of blank lenses can be inverted."""
    ridge: NDArray[np.float64] = 1e-9 * np.trace(normal[:, :2, :2].sum(0)) / len(normal) * np.eye(2)
    return ridge


def invert_2x2(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2, 2) inverses of symmetric positive matrices; LAPACK takes several times as long for such small ones."""
    xx, xy, yy = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    over = 1 / np.maximum(xx * yy - xy * xy, np.finfo(float).tiny)
    return np.stack([yy * over, -xy * over, -xy * over, xx * over], axis=1).reshape(-1, 2, 2)
