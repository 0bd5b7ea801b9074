"""Tuned values of the check of a calibration against a flat, and the looks of the picture that shows it."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CAMERA_CHECK", "FIT_CHECK", "STYLE", "CameraCheckSettings", "FitCheckSettings", "OverlayStyle"]

Colour = tuple[int, int, int]


@dataclass(frozen=True)
class FitCheckSettings:
    """Tuned values of `fit_check`."""

    edge_window: float = 0.5  # [pitch] of local normalisation: wider than a rim, narrower than detail of the scene
    largest_scatter: float = 0.05  # [pitch] between the lattices of two halves of a flat that shows one
    samples: int = 4000  # lenses at which lattices are compared


@dataclass(frozen=True)
class CameraCheckSettings:
    """Tuned values of `camera_check`; distances measured on 60 simulated flats and 8 captures with right cameras."""

    linear: float = 0.0025  # change of scale or angle [rad]: at most 0.0011 with right cameras
    corner: float = 0.2  # [pitch] in the corners: at most 0.08 with right cameras
    same_cell: float = 0.1  # change of scale or angle, beyond which it is another lattice
    repeatability: float = 0.5  # of the average microimage of a lattice that counts
    candidates: int = 3  # lattices of the spectrum that are compared
    fine_pitch: float = 18.0  # [px] finer microimages than this take time and tell no more
    coarse_pitch: float = 10.0  # [px] to which those of large flats are averaged
    pixels: float = 4e6  # of large flats, after averaging
    tiles: int = 4  # along the longer side of the flat, and
    bins: int = 36  # along each side, of the average microimage whose roundness is compared
    known_rims: float = 0.03  # difference of light between types at the rims in a gain map that tells their order
    clear_rims: float = 0.5  # of it, which a scene must show to contradict,
    same_rims: float = 0.75  # and cosine between both: 1/2 if two of three types are exchanged
    nearly_as_round: float = 0.9  # [roundness about the centres found] where both may be the centres


@dataclass(frozen=True)
class OverlayStyle:
    """Sizes [px] and colours of the picture that `show` draws."""

    panel: int = 560  # side
    space: int = 16  # between panels
    caption: int = 26  # height below a panel
    header: int = 84  # height above the panels
    margin: int = 24  # left of the headlines
    least_zoom: float = 3.0  # of the crops
    most_zoom: float = 4.0  # of the crops
    least_pitches: float = 2.5  # across a crop, whatever the zoom
    pitches: float = 6.0  # across a crop, if the zoom allows
    residual_significance: float = 3.0  # [standard errors] least of a residual that is drawn as an arrow
    background: Colour = (24, 26, 30)
    paper: Colour = (38, 41, 47)
    ink: Colour = (232, 234, 237)
    faint: Colour = (130, 136, 146)
    grid_line: Colour = (70, 74, 82)
    circle: Colour = (0, 190, 255)
    cross: Colour = (255, 190, 40)
    arrow: Colour = (255, 120, 90)
    defect: Colour = (255, 60, 200)
    unknown: Colour = (60, 20, 50)
    types: tuple[Colour, ...] = ((0, 190, 255), (255, 110, 200), (140, 240, 90), (250, 230, 80))  # circles by lens type


CAMERA_CHECK = CameraCheckSettings()
FIT_CHECK = FitCheckSettings()
STYLE = OverlayStyle()
