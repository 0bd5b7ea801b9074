"""The discs of the microlenses from edges of boards at many known depths.

An edge in a microimage is blurred by the pixel, by the disc `A |s / D - f|` of its microlens, and
by a blur that all depths share (print, diffraction, aberrations), taken as one more disc. The
squares of the discs add up, so that they are a parabola over `s / D`: its width is the aperture `A`
and its vertex the focus `f` of each lens type.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..camera.lens_types import LensBlur
from ..microimage.edge import blurred_edge

__all__ = ["Edges", "fit_discs"]

_Array = NDArray[np.float64]

#: [px] Error of discs that the scatter of boards does not show, of 1 px and more; smaller ones have
#: as many times more. Measured on `boards/` and by `python -m benchmarks.lens_blur boards`.
_FAULT = 0.1
#: Depths at which the camera file holds discs.
_DEPTHS = 7
#: [px] Places at which edges are tabulated, and discs.
_PLACE_STEP = 0.01
_WIDEST = 12
_DISC_STEP = 0.25
#: [px] Gaussians that may blur an edge most alike.
_WIDTHS = (0.1, 6)
#: [px] Least disc that all depths share, and what is added to discs for weights.
_LEAST_COMMON = 0.1
_LEAST_DISC = 0.3


class Edges(NamedTuple):
    """Edges of boards, the mean of each pose and lens type."""

    kind: NDArray[np.int64]  # (n,) lens type
    ratio: _Array  # (n,) s / D
    width: _Array  # (n,) [px] standard deviation of the Gaussian that blurs an edge most alike
    spread: _Array  # (n,) [px] scatter of the widths: wide where unknown lens types are mixed


@lru_cache(1)
def _tabulate_widths() -> tuple[_Array, _Array]:
    """Discs [px] and the Gaussians [px] whose edges are nearest to theirs, on square pixels."""
    from scipy.optimize import minimize_scalar
    from scipy.special import erf

    count = round(_WIDEST / _PLACE_STEP)
    place = _PLACE_STEP * np.arange(-count, count + 1)
    discs = np.arange(0, _WIDEST + _DISC_STEP / 2, _DISC_STEP)
    widths = []
    for disc in discs:
        edge = 2 * blurred_edge(place, max(disc, _PLACE_STEP) / 2, 1.0).light - 1

        def miss(width: float, edge: _Array = edge) -> float:
            return float(((erf(place / (np.sqrt(2) * width)) - edge) ** 2).sum())

        widths.append(minimize_scalar(miss, bounds=_WIDTHS, method="bounded").x)
    return discs, np.array(widths)


def fit_discs(edges: Edges, count: int, pitch: float, rims: LensBlur | None) -> LensBlur | None:
    """The aperture and the focus of `count` lens types; None if the boards do not tell them.

    Where `rims` of a white image are known, they are one more measurement of each type.
    """
    from scipy.optimize import least_squares

    if not len(edges.kind):
        return None
    discs, widths = _tabulate_widths()
    seen = np.interp(edges.width, widths, discs)
    start = _fit_parabolas(edges, seen, count)
    if start is None:
        return None
    kinds = edges.kind
    ratios = edges.ratio
    spread = np.interp(edges.width + edges.spread, widths, discs) - seen
    faults = np.hypot(_FAULT / np.minimum(seen + _FAULT, 1.0), spread)
    if rims is not None and not rims.tells_aperture and len(rims.focus) == count:
        rim, errors = rims.at([0.0])
        kinds = np.append(kinds, np.arange(count))
        ratios = np.append(ratios, np.zeros(count))
        seen = np.append(seen, rim)
        faults = np.append(faults, np.maximum(errors, _FAULT))
    at_edge = np.arange(len(kinds)) < len(edges.kind)

    def discs_of(p: _Array) -> _Array:
        return np.asarray(p[0] * (ratios - p[1 : 1 + count][kinds]))

    def miss(p: _Array) -> _Array:
        return np.asarray((np.hypot(discs_of(p), p[-1] * at_edge) - seen) / faults)

    found = least_squares(miss, start, loss="soft_l1", x_scale=[pitch, *[1.0] * count, 1.0])
    scatter = max(1.0, float((found.fun**2).sum()) / max(len(seen) - len(start), 1))
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * scatter
    aperture = abs(float(found.x[0]))
    focus = found.x[1 : 1 + count]
    deviations = np.sqrt(np.diag(covariance))
    depths = np.quantile(edges.ratio, np.linspace(0, 1, _DEPTHS)).round(4)
    by_unknown = np.zeros((count, _DEPTHS, len(start)))
    away = depths - focus[:, None]
    by_unknown[..., 0] = away
    for kind in range(count):
        by_unknown[kind, :, 1 + kind] = -aperture
    variance = np.einsum("kdi,ij,kdj->kd", by_unknown, covariance, by_unknown)
    return LensBlur(
        aperture,
        float(deviations[0]),
        focus,
        deviations[1 : 1 + count],
        depths,
        aperture * np.abs(away),
        np.sqrt(variance + _FAULT**2),
    )


def _fit_parabolas(edges: Edges, discs: _Array, count: int) -> _Array | None:
    """Aperture, foci and common disc from `discs^2 = p s^2 + q_k s + t_k`, by least squares."""
    own = edges.kind[:, None] == np.arange(count)
    if own.sum(0).min() < 2 or len(discs) < 1 + 2 * count:
        return None
    table = np.column_stack([edges.ratio**2, own * edges.ratio[:, None], own])
    # Errors of squares grow with the disc.
    weight = 1 / (discs + _LEAST_DISC)
    p, *rest = np.linalg.lstsq(table * weight[:, None], discs**2 * weight, rcond=None)[0]
    if p <= 0:
        return None
    focus = -np.array(rest[:count]) / (2 * p)
    floor = np.array(rest[count:]) - p * focus**2
    common = np.sqrt(np.maximum(floor.mean(), _LEAST_COMMON**2))
    return np.array([np.sqrt(p), *focus, common])
