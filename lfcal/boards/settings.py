"""Tuned values of finding boards and their corners."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "CORNER",
    "DETECTION",
    "SWEEP",
    "CornerSettings",
    "DetectionSettings",
    "SweepSettings",
]


@dataclass(frozen=True)
class CornerSettings:
    """Tuned values of `fit_corners`."""

    window: float = 0.7  # [squares] to each side of the corner; 1 is the next corner
    rim: float = 1.0  # [px] that the edge of a microimage is soft
    first_blur: float = 1.0  # [px] standard deviation
    least_blur: float = 0.25  # [px]; a pixel alone has 0.29
    largest_blur: float = 6.0  # [px]
    iterations: int = 9
    transfer_from: int = 3  # iteration from which on the transfer is fitted, once the corners are about right
    damping: float = 1e-4  # of the unit diagonal
    largest_step: float = 1.0  # [px] of an iteration
    block: int = 1500  # corners fitted side by side; a few hundred MB
    marker_margin: float = 0.8  # of the white margin about the markers of a ChArUco board
    least_eigenvalue: float = 0.02  # of the unit normal matrix: below, the pixels show one edge only
    fewest_pixels: int = 25
    least_contrast: float = 0.4  # of the median contrast
    largest_residual: float = 0.2  # standard deviation, of the contrast; a clean corner has 0.01 to 0.05
    largest_shift: float = 0.35  # [squares] from the prediction
    largest_error: float = 0.5  # [px] along the worse axis


@dataclass(frozen=True)
class DetectionSettings:
    """Tuned values of `detect`."""

    black_share: float = 1.0  # [%] of the pixels that are drawn black
    white_share: float = 1.0  # [%] of the pixels that are drawn white
    zooms: tuple[float, ...] = (1.0, 2.0, 0.5)  # of the picture, tried in turn; detectors need squares of 8 to 80 px


@dataclass(frozen=True)
class SweepSettings:
    """Tuned values of `focused_picture`. Lengths are in pitches `D`."""

    least_ratio: float = 0.05  # |s| / D: nearer to the microlenses lenses share too little of the scene
    largest_ratio: float = 0.75  # |s| / D: beyond, neighbours share too little
    ratio_step: float = 0.025  # about half a pixel between lenses one pitch apart, at D = 23 px
    lenses: int = 7  # that draw a point at most: the nearest one and a ring about it
    coarse_step: float = 0.15  # between the points at which candidates are compared
    fine_step: float = 0.075  # between the pixels of the picture
    window: float = 1.5  # over which agreement is averaged: a lens and half of its neighbours
    least_share: float = 0.3  # of a window that two lenses or more must see


DETECTION = DetectionSettings()
CORNER = CornerSettings()
SWEEP = SweepSettings()
