"""Panels of a calibration: crops with circles, offsets, light of a microimage.

Every panel is a figure of its own, so that a page lays them out side by side or below each other.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, check_fit
from lfcal.runtime.arrays import stretch_contrast

from .report_pictures import picture_url
from .templates import fill

__all__ = ["calibration_panels", "flat_part"]

_TYPES = ("#5cb8ff", "#ff6fb5", "#7be07b", "#ffd84d")  # circles of lens types
_SIDE = 320  # of a panel, in the units of its drawing
_MARGIN = 20  # around the flat on a panel, in the same units
# Length of the longest arrow, as a share of the side, so that arrows of neighbours do not meet; and
# the shortest offset [px] that such an arrow may stand for.
_LONGEST_ARROW = 0.11
_SHORTEST = 1e-3
_UNKNOWN = (214, 110, 160)  # colour of pixels without a gain: pink
# Width of crops [pitches].
_CROP = 6.0


def calibration_panels(flat: NDArray, calibration: Calibration) -> Any:
    """HTML of the panels: crops of three places, six pitches wide, and what was measured.

    FlatError if the flat is not of the size the calibration is for.
    """
    width, height = calibration.image_size
    places = {
        "Top left": (0, 0),
        "Centre": (width / 2, height / 2),
        "Bottom right": (width, height),
    }
    crops = [
        (name, _crop(flat, calibration, np.array(place, float), _CROP))
        for name, place in places.items()
    ]
    fit = check_fit(calibration, flat)
    return fill(
        "calibration.html",
        crops=crops,
        radius=calibration.lattice.radius,
        offsets=_offsets(calibration, fit),
        verdict=f"{fit.verdict[:1].upper()}{fit.verdict[1:]}.",
        light=_falloff(calibration),
        gain=_gain(calibration),
        defects=calibration.defects,
    )


def flat_part(flat: NDArray, middle: NDArray[np.float64], side: float) -> dict[str, Any]:
    """A part of the flat, `side` pixels across, with all its contrast.

    It is drawn by the macro `crop`.
    """
    size = np.array(flat.shape[1::-1])
    reach = np.minimum(np.round(side).astype(int), size)
    low = np.clip(np.round(middle - reach / 2).astype(int), 0, size - reach)
    shown = stretch_contrast(flat[low[1] : low[1] + reach[1], low[0] : low[0] + reach[0]])
    (x, y), (width, height) = (low - 0.5).tolist(), reach.tolist()
    return {"x": x, "y": y, "width": width, "height": height, "url": picture_url(shown)}


def _crop(
    flat: NDArray, calibration: Calibration, middle: NDArray[np.float64], pitches: float
) -> dict[str, Any]:
    """A part of the flat with the circles of its lenses, and those that get no light."""
    lattice = calibration.lattice
    types = calibration.lens_types
    part = flat_part(flat, middle, pitches * lattice.pitch)
    low = np.array([part["x"], part["y"]]) - lattice.pitch
    high = low + [part["width"], part["height"]] + 2 * lattice.pitch
    centres = lattice.centres()
    unlit = lattice.points(calibration.defects.lenses)
    near = ((centres > low) & (centres < high)).all(1)
    kinds = np.zeros(near.sum(), int)
    if types is not None:
        kinds = types.of(lattice.indices()[near]) % len(_TYPES)
    circles = [(x, y, _TYPES[kind]) for (x, y), kind in zip(centres[near], kinds, strict=True)]
    return {
        **part,
        "circles": circles,
        "unlit": unlit[((unlit > low) & (unlit < high)).all(1)].tolist(),
    }


def _offsets(calibration: Calibration, fit: Any) -> dict[str, Any]:
    """Arrows from the centres of the lattice to those that nine regions of the flat show."""
    size = np.array(calibration.image_size)
    scale = (_SIDE - 2 * _MARGIN) / size.max()
    corner = (_SIDE - scale * size) / 2
    positions = fit.positions.reshape(-1, 2)
    offsets = fit.offset.reshape(-1, 2)
    lengths = np.linalg.norm(offsets, axis=-1)
    longest = float(np.nanmax(lengths, initial=_SHORTEST))
    drawn = np.nan_to_num(offsets) * _LONGEST_ARROW * _SIDE / longest
    at = corner + scale * (positions + 0.5)
    told = [length if np.isfinite(length) else None for length in lengths.tolist()]
    arrows = [
        (*place, *arrow, length)
        for place, arrow, length in zip(at.tolist(), drawn.tolist(), told, strict=True)
    ]
    return {"left": float(corner[0]), "top": float(corner[1]), "arrows": arrows}


def _falloff(calibration: Calibration) -> dict[str, Any] | None:
    """Distances from the centre [px] and the light there."""
    vignetting = calibration.vignetting
    if vignetting is None:
        return None
    distances = np.arange(len(vignetting.profile)) * float(vignetting.step)
    points = list(zip(distances.tolist(), vignetting.profile.tolist(), strict=True))
    # The line of the usable radius stands inside the panel.
    beyond = calibration.lattice.radius + float(vignetting.step)
    return {"end": max(float(distances[-1]), beyond), "points": points}


def _gain(calibration: Calibration) -> str:
    """The gain map of some microimages in a corner of the flat, "" without a map.

    Unknown pixels are pink.
    """
    if calibration.gain_map is None:
        return ""
    side = int(max(8, 6 * calibration.lattice.pitch))
    gain = calibration.gain()[:side, :side]
    drawn = np.repeat(
        np.rint(255 * np.clip(np.nan_to_num(gain), 0, 1)).astype(np.uint8)[..., None], 3, axis=2
    )
    drawn[np.isnan(gain)] = _UNKNOWN
    return picture_url(drawn, ".png")
