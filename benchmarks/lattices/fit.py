"""Fit the weights of `lfcal.camera.evidence` to right and wrong lattices of simulated cameras and
of no flats.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from lfcal import CalibrationError, Lattice
from lfcal.camera.evidence import Evidence
from lfcal.detection import search
from lfcal.images.mosaic import equalise_mosaic, find_mosaic, remove_mosaic
from lfcal.images.preprocessing import sqrt_luminance

from ..camera_kinds import draw_kind
from ..no_flats import draw_no_flat
from .judgement import compare_with_centres
from .random_cameras import draw_camera

__all__ = ["Example", "collect_examples", "fit_weights", "whole_centres"]

#: Wrong lattices of a flat that are fitted: those that are most like right ones.
_HARD = 6
#: Penalty of the squared weights, of terms over their standard deviation.
_PENALTY = 1e-3


@dataclass(frozen=True)
class Example:
    """The evidence of a lattice on a flat, and whether it is the right one."""

    flat: str
    evidence: Evidence
    right: bool


def collect_examples(first: int, last: int) -> Iterator[Example]:
    """All candidates on flats of seeds: drawn by formula, ray-traced, and pictures that are no
    flats.
    """
    for seed in range(first, last):
        drawn = draw_camera(seed)
        yield from _examples(drawn.name, drawn.image, drawn.centres)
        name, capture = draw_kind(seed)
        yield from _examples(name, capture.flat, whole_centres(capture.truth.calibration.lattice))
        name, picture = draw_no_flat(seed)
        yield from _examples(f"{name} {seed}", picture, None)


def whole_centres(lattice: Lattice) -> NDArray[np.float64]:
    """(n, 2) centres of lenses half a pitch from the borders of the flat."""
    centres = lattice.centres()
    margin = lattice.pitch / 2
    most = np.array(lattice.image_size) - 1 - margin
    return centres[(centres >= margin).all(1) & (centres <= most).all(1)]


def _examples(
    name: str, flat: NDArray[Any], centres: NDArray[np.float64] | None
) -> Iterator[Example]:
    if flat.ndim == 2 and find_mosaic(flat):
        flat = remove_mosaic(equalise_mosaic(flat))
    try:
        candidates = search.find_candidates(sqrt_luminance(flat), thorough=True)
    except CalibrationError:
        return
    for one in candidates:
        right = centres is not None and compare_with_centres(one.lattice, centres).is_right
        yield Example(name, one.evidence, right)


def fit_weights(examples: list[Example]) -> tuple[float, dict[str, float]]:
    """Log odds without evidence, and the weight of each term: logistic regression on all right and
    hard wrong ones.
    """
    names = list(examples[0].evidence.terms())
    terms = np.array([list(one.evidence.terms().values()) for one in examples])
    right = np.array([one.right for one in examples])
    flats = np.unique([one.flat for one in examples], return_inverse=True)[1]
    scale = terms.std(0) + 1e-9
    chosen = np.ones(len(examples), bool)
    for _ in range(4):
        constant, weights = _fit_logistic(terms[chosen] / scale, right[chosen])
        odds = constant + terms / scale @ weights
        chosen = right.copy()
        for flat in range(int(flats.max()) + 1):
            wrong = np.flatnonzero((flats == flat) & ~right)
            chosen[wrong[np.argsort(-odds[wrong])[:_HARD]]] = True
    return constant, dict(zip(names, (weights / scale).tolist(), strict=True))


def _fit_logistic(
    terms: NDArray[np.float64], right: NDArray[np.bool_]
) -> tuple[float, NDArray[np.float64]]:
    design = np.column_stack([np.ones(len(terms)), terms])

    def loss(weights: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        odds = design @ weights
        size = float((weights[1:] ** 2).sum())
        value = float(np.mean(np.logaddexp(0, odds) - right * odds)) + _PENALTY * size
        slope = design.T @ (1 / (1 + np.exp(-odds)) - right) / len(terms)
        slope[1:] += 2 * _PENALTY * weights[1:]
        return value, slope

    found = minimize(loss, np.zeros(design.shape[1]), jac=True, method="L-BFGS-B").x
    return float(found[0]), np.asarray(found[1:])
