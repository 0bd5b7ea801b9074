"""Scenes that are one plane facing the camera: one number for all lenses, checked on every one of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal import Lattice

from .modes import confidence, parabola_peak
from .refinement import fit_pairs
from .search import MISFIT, Matcher, Preset
from .skipping import sample_lenses
from .slant import fit_lenses
from .texture import Texture

__all__ = ["Plane", "find_plane"]

# So many lenses tell a plane, or at least the second number of them.
_SAMPLE, _LEAST_SAMPLE = 96, 40
# Share of all lenses that must clearly carry texture, and of the sample that must lie on the plane.
_TEXTURED, _ON_PLANE = 0.5, 0.95
# Patch sizes [share of the pitch] between which neither shading nor missing overlap can play a part.
_NEAREST_ZERO, _LARGEST = 0.1, 0.7
# A smooth surface through the sample may leave the plane by this much [px]: half of what the shortcut may cost.
_EVEN = 0.025
# Three shifts this far apart [px of the search] tell for each lens whether it, too, has its optimum there. A lens and
# this many of its neighbours that are off to one side by the second number are a surface of their own: fewer are noise.
_PROBE, _OFF, _TOGETHER = 0.75, 0.4, 3
# A better match elsewhere, by this much, is another surface; so is a share of the lenses without any match.
_BETTER, _MISFITS = 0.15, 0.02
# Systematic error of a patch size [px], which no number of lenses averages out.
_FLOOR = 0.006


@dataclass(frozen=True)
class Plane:
    """A plane facing the camera.

    Parameters
    ----------
    patch_size, standard_error : float [px]
    confidence : float
        0..1, of the lenses that show it.
    evidence : (n,) float32
        Correlation of each lens with its neighbours there, 0..1.
    sampled : float
        Share of the lenses that were matched at all shifts.
    """

    patch_size: float
    standard_error: float
    confidence: float
    evidence: NDArray[np.float32]
    sampled: float


def find_plane(
    texture: Texture, lattice: Lattice, forward: NDArray[np.int32], backward: NDArray[np.int32], setting: Preset
) -> Plane | None:
    """The one plane that the flat shows, None where there are several depths or it cannot be told.

    Parameters
    ----------
    texture : Texture
        Shading may be left in.
    lattice : Lattice
    forward, backward : (n, d) int32
        Neighbour rows in `d` directions and in their opposites, -1 where there is none.
    setting : Preset
    """
    if texture.clear.mean() < _TEXTURED:
        return None
    sample = sample_lenses(lattice, texture.clear, _SAMPLE)
    if sample.sum() < _LEAST_SAMPLE:
        return None
    matcher = Matcher(texture, forward, backward, setting)
    cost = matcher.costs(matcher.pairs(sample))[sample]
    best = cost.argmin(1)
    found = (matcher.shifts[best] + parabola_peak(cost, best) * matcher.step) * matcher.factor
    about = float(np.median(found))
    if not _NEAREST_ZERO * lattice.pitch < abs(about) < _LARGEST * lattice.pitch:
        return None
    near = np.abs(found - about) < matcher.tolerance() * matcher.step * matcher.factor
    if near.mean() < _ON_PLANE:
        return None
    size = _refined(texture, lattice, forward, backward, sample, about, setting)
    if size is None:
        return None
    evidence = _evidence(matcher, texture, size[0] / matcher.factor)
    if evidence is None:
        return None
    paths = 2 * forward.shape[1]
    sure = float(np.median(confidence(cost * np.float32(paths), best, paths, matcher.tolerance())))
    return Plane(size[0], size[1], sure, evidence, float(sample.mean()))


def _refined(
    texture: Texture,
    lattice: Lattice,
    forward: NDArray[np.int32],
    backward: NDArray[np.int32],
    sample: NDArray[np.bool_],
    about: float,
    setting: Preset,
) -> tuple[float, float] | None:
    """Patch size of the sample and its standard error [px]; None where the sample is not level."""
    start = np.where(sample, about, np.nan).astype(np.float32)
    scale = np.maximum(3 * texture.noise, 0.5 * texture.statistics.contrast)
    pairs = fit_pairs(texture.flat, forward, start, scale, setting.iterations)
    lenses = fit_lenses(texture.flat, forward, backward, pairs, start)
    known = np.flatnonzero(sample & np.isfinite(lenses.standard_error))
    if len(known) < _LEAST_SAMPLE:
        return None
    sizes = lenses.patch_size[known].astype(np.float64)
    size = float(np.median(sizes))
    scatter = 1.48 * float(np.median(np.abs(sizes - size)))
    inside = np.abs(sizes - size) < 4 * max(scatter, _FLOOR)
    if inside.mean() < _ON_PLANE * 0.95:
        return None
    x, y = (2 * lattice.centres()[known[inside]] / lattice.image_size - 1).T
    terms = np.stack([np.ones(len(x)), x, y, x * x, x * y, y * y], 1)
    onto = terms @ np.linalg.pinv(terms)
    # What the scatter of single lenses leaves uncertain about that surface is not held against the plane.
    uncertain = 2 * scatter * np.sqrt(np.diag(onto))
    if (np.abs(onto @ sizes[inside] - sizes[inside].mean()) > _EVEN + uncertain).any():
        return None
    return float(sizes[inside].mean()), float(np.hypot(_FLOOR, scatter / np.sqrt(inside.sum())))


def _evidence(matcher: Matcher, texture: Texture, shift: float) -> NDArray[np.float32] | None:
    """(n,) correlation of every lens at the plane's shift; None where a lens shows something else."""
    everyone = texture.clear | texture.faint
    probes = (shift + _PROBE * np.array([-1, 0, 1])).astype(np.float32)
    cost = matcher.costs(matcher.pairs(everyone, probes))
    fits = cost[:, 1] <= MISFIT
    off = _vertex(cost) * _PROBE
    rows = np.hstack([matcher.forward, matcher.backward])
    for side in (-1, 1):
        stray = np.flatnonzero(texture.clear & fits & (side * off > _OFF))
        if (np.isin(rows[stray], stray).sum(1) >= _TOGETHER).any():
            return None
    misfits = texture.clear & ~fits
    if misfits.mean() > _MISFITS:
        return None
    if misfits.any():
        full = matcher.costs(matcher.pairs(misfits))[misfits]
        least = full.min(1)
        if ((least < cost[misfits, 1] - _BETTER) & (least < MISFIT)).any():
            return None
    return (1 - cost[:, 1]).astype(np.float32)


def _vertex(cost: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n,) where the parabola through three costs has its least value, in steps from the middle, at most 1 away."""
    bend = cost[:, 0] - 2 * cost[:, 1] + cost[:, 2]
    tilt = 0.5 * (cost[:, 0] - cost[:, 2])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(bend > 1e-6, np.clip(tilt / bend, -1, 1), np.sign(tilt)).astype(np.float32)
