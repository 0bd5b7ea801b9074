"""Light of single microimages: how it scatters inside them, and from one to the next.

Microimages of a white image are evenly lit inside, and as bright as their neighbours; those of a
scene are not. Differences between lens types are left out of both.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..camera.lattice_figures import white_probability
from ..images.preprocessing import interpolate_linear
from ..lattice.lattice import Lattice
from ..lattice.lens_subset import sample_lenses
from ..microimage.lit import is_lit
from ..runtime.arrays import Floats, Integers, Singles

__all__ = ["Tones", "is_white_image", "measure_tones"]

#: Lenses measured, evenly spread over the flat, and lens types told apart in each lattice
#: direction.
_LENSES = 500
_PERIOD = 6
#: Share of the radius that is measured, within which a spot is in the middle.
_CENTRAL = 0.4
#: Light over that of bright lenses, from which on they are measured: with 0.16, a flat of small
#: microimages with dark ones (elemental_16px) is found to be no certain scene.
_LIT = 0.09
#: Relative difference of light that makes a lens unlike its neighbours.
_UNLIKE = 0.1
#: Scatter that is added before logarithms are taken.
_LEAST = 1e-3


class Tones(NamedTuple):
    """Scatter of the light of microimages, relative to the light: logarithms, but for a share."""

    inside: float  # standard deviation inside the typical lit microimage, without what all share
    # robust standard deviation from what the neighbours on both sides have, beyond noise
    between: float
    detail: float  # that inside lenses with much detail (95 %), over that in typical ones
    unlike: float  # share of lenses that differ from their neighbours by `_UNLIKE`, beyond noise


def measure_tones(picture: Singles, lattice: Lattice) -> Tones | None:
    """Tones of lenses on a picture (h, w), the square root of the luminance; None for fewer than 24
    lit lenses.
    """
    steps = lattice.steps @ lattice.basis
    nearest = float(np.hypot(*steps.T).min())
    indices, centres = sample_lenses(lattice, 1.5 * float(np.hypot(*steps.T).max()) + 1, _LENSES)
    grid = np.linspace(-1, 1, 7)
    core = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
    core = core[np.hypot(*core.T) < 1 + 1e-9] * min(0.25 * nearest, 0.6 * lattice.radius)
    values = (
        interpolate_linear(picture, centres[:, None] + core) if len(centres) else np.zeros((0, 1))
    )
    tones = values.mean(1)
    lit = is_lit(tones**2, _LIT)
    if lit.sum() < 24:
        return None
    indices = indices[lit]
    centres = centres[lit]
    values = values[lit]
    tones = tones[lit]
    scatter = _scatter_inside(values / tones[:, None], core)
    inside, most = np.quantile(scatter, (0.5, 0.95))
    if most == 0:
        # Spots, or masks without noise: their tones are those of the pixels that samples fall on.
        return Tones(float(np.log(_LEAST)), float(np.log(_LEAST)), 0.0, 0.0)
    detail = float(np.log(max(float(most / max(float(inside), 1e-6)), 1.0)))
    types = indices[:, 0] % _PERIOD * _PERIOD + indices[:, 1] % _PERIOD
    bends = []
    for step in steps[: len(steps) // 2]:
        beside = [
            interpolate_linear(picture, (centres + side * step)[:, None] + core).mean(1)
            for side in (-1, 1)
        ]
        bend = np.log(np.maximum(beside[0], 1e-6) / tones) + np.log(
            np.maximum(beside[1], 1e-6) / tones
        )
        bends.append(_without_types(bend, types))
    bend = np.abs(np.array(bends)).min(0)
    # Half of all squares of normal values lie below 0.4549; a second difference has six times the
    # variance.
    between = float(np.median([np.sqrt(np.median(one**2) / 0.4549 / 6) for one in bends]))
    # Noise inside lenses scatters their means, too, and second differences by the root of six.
    noise = float(inside) / np.sqrt(len(core))
    between = float(np.sqrt(max(between**2 - noise**2, 0.0)))
    unlike = bend > np.hypot(_UNLIKE, 2 * np.sqrt(6) * noise)
    inside = float(np.log(float(inside) + _LEAST))
    return Tones(inside, float(np.log(between + _LEAST)), detail, float(unlike.mean()))


def _scatter_inside(shape: Floats, core: Floats) -> Floats:
    """(n,) scatter of lenses of `shape` (n, m) at places `core` (m, 2), without what all have in
    common, and planes.

    Vignetting is about a plane in each lens. Where all are darker, as around spots, nothing is
    compared; spots of a few pixels in the middle show nothing at all.
    """
    common = np.median(shape, axis=0)
    bright = common >= 0.9 * common.max()
    plane = np.column_stack([np.ones(len(core)), core])
    if bright.sum() <= plane.shape[1]:
        far = np.hypot(*core[bright].mean(0))
        if far < _CENTRAL * np.hypot(*core.T).max():
            return np.zeros(len(shape))
        bright[:] = True
    plane = plane[bright]
    rest = (shape - common)[:, bright].T
    rest = rest - plane @ np.linalg.lstsq(plane, rest, rcond=None)[0]
    scatter: Floats = np.sqrt((rest**2).mean(0))
    return scatter


def _without_types(values: Floats, types: Integers) -> Floats:
    """The values (n,) less the median of those of the same type."""
    order = np.lexsort((values, types))
    _, first, member, count = np.unique(
        types[order], return_index=True, return_inverse=True, return_counts=True
    )
    ordered = values[order]
    middle = (ordered[first + (count - 1) // 2] + ordered[first + count // 2]) / 2
    left = np.empty_like(values)
    left[order] = ordered - middle[member]
    return left


def is_white_image(picture: Singles, lattice: Lattice) -> bool:
    """Whether a picture (h, w), the square root of the luminance, shows evenly lit microimages on a
    lattice.
    """
    tones = measure_tones(picture, lattice)
    if tones is None:
        return False
    return white_probability(tones.inside, tones.detail, tones.unlike) > 0.5
