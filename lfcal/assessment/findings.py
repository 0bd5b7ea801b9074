"""Findings about the geometry of an array: rotation, tilt, distance and gaps of microimages."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..gain.gain_map import nearest_half
from ..lens_blur.microimages import MicroimageField
from .alignment import Alignment
from .result import SURE, Finding

__all__ = [
    "LEAST_GAP",
    "SURE",
    "Seen",
    "direction_name",
    "find_apertures",
    "find_distance",
    "find_rotation",
    "find_tilt",
    "unmeasured",
]

Vector = NDArray[np.float64]
# [standard errors] A larger difference of two measurements is a contradiction.
_APART = 4.0
# Error of the radii where microimages overlap [px]: up to 0.21 on simulated cameras.
_OVERLAP_FAULT = 0.15
# [radius] Twice the change of the radii per half diagonal that is too little to matter.
_LEAST_TILT = 0.01
# Correlations with the change of the radii at which pitches or rims confirm a tilt, and the change
# of the rims over that of the radii.
_SAME_WAY = 0.7
_SAME_WAY_OF_RIMS = 0.8
_RIM_SHARE = (0.15, 1.5)
# [rim blur] Least change of the rims over the field that is reported.
_LEAST_CHANGE = 0.1
# [pitch], [radius] Least gaps and cuts that are reported; errors of gaps that count as small.
LEAST_GAP = 0.02
_SURE_GAP = 0.05
_WAYS = ("right", "lower right", "bottom", "lower left", "left", "upper left", "top", "upper right")


class Seen(NamedTuple):
    """A white image, its calibration, measurements on both, and the main lens if known."""

    flat: NDArray[Any]
    camera: Calibration
    alignment: Alignment
    field: Any  # MicroimageField, None of findings that do without
    f_number: float | None = None  # as seen from the sensor
    pupil: float | None = None  # [px] distance of the exit pupil
    pixel: float | None = None  # [mm]
    top: float | None = None  # largest value that pixels can have; None if unknown

    def length(self, pixels: float) -> str:
        """A distance in the unit that is known."""
        if self.pixel is None:
            return f"{pixels:.2g} px"
        return f"{1000 * pixels * self.pixel:.2g} um"


def unmeasured(unit: str, why: str) -> Finding:
    """A finding without a value."""
    return Finding(float("nan"), float("nan"), unit, f"not measured: {why}")


def direction_name(vector: Vector) -> str:
    return _WAYS[round(float(np.arctan2(vector[1], vector[0])) / (np.pi / 4)) % 8]


def find_rotation(found: Alignment, camera: Calibration) -> Finding:
    """Rotation of the rows of lenses."""
    value = found.rotation
    error = found.rotation_error
    told = partial(
        Finding, value, error, "degrees", details={"lattice": found.shape, "rows": found.rows}
    )
    rows = f"the {found.rows} rows of lenses"
    if found.rows == "both ways":
        rows = "the rows of lenses"
    drift = abs(np.radians(value)) * max(camera.image_size)
    if not np.isfinite(error):
        return told("its error is not known, so there is no advice")
    if drift < 0.5:
        return told(f"{rows} lie along those of the sensor")
    if abs(value) <= SURE * error:
        return told(f"{rows} are not turned by more than {abs(value) + SURE * error:.2g} degrees")
    here, back = ("clockwise", "counter-clockwise")[:: 1 if value > 0 else -1]
    return told(
        f"{rows} are turned {here} on the flat, by {drift:.1f} px over it",
        f"to align them turn the array by {abs(value):.3g} degrees {back} as it looks on the flat, "
        f"that is {here} seen from the main lens (unless the camera mirrors its flats)",
    )


def find_tilt(seen: Seen) -> Finding:
    """Tilt of the sensor against the array, from radii and pitches of microimages.

    A microimage has the radius `b / 2N`: a tilt `g` changes it by `g / 2N` per pixel.
    """
    found = seen.alignment
    radius = seen.field.radius
    number = seen.f_number
    lattice = seen.camera.lattice
    reach = float(np.hypot(*lattice.image_size)) / 2
    slope = radius.slope
    bent = found.gradient
    bent_error = found.gradient_error
    if radius.value > nearest_half(lattice):
        bent_error = float(np.hypot(bent_error, _OVERLAP_FAULT))
    per_number = number is None and np.isfinite(radius.slope_error)
    tilts = []
    if np.isfinite(radius.slope_error):
        tilts.append(
            (2 * slope / reach * (number or 1.0), 2 * radius.slope_error / reach * (number or 1.0))
        )
    if seen.pupil is not None and np.isfinite(bent_error) and not per_number:
        tilts.append((bent / reach**2 * seen.pupil, bent_error / reach**2 * seen.pupil))
    if not tilts:
        return unmeasured(
            "degrees", "too few microimages with rims, and the distance of the pupil is not given"
        )
    weight = [1 / error**2 for _, error in tilts]
    vector = np.average([tilt for tilt, _ in tilts], axis=0, weights=weight)
    value = float(np.degrees(np.hypot(*vector)))
    error = float(np.degrees(sum(weight) ** -0.5))
    to_right, to_bottom = np.degrees(vector).tolist()
    unit = "degrees"
    if per_number:
        unit = "degrees per f-number"
    told = partial(
        Finding, value, error, unit, details={"to_right": to_right, "to_bottom": to_bottom}
    )
    if len(tilts) == 2 and np.hypot(*(tilts[0][0] - tilts[1][0])) > _APART * np.hypot(
        tilts[0][1], tilts[1][1]
    ):
        return told(
            "radii and pitches tell different tilts: the main lens distorts or cuts microimages "
            "on one side"
        )
    if value <= SURE * error:
        limit = f" larger than {SURE * error:.2g} degrees"
        if per_number:
            limit = ""
        return told(f"no tilt{limit} is seen: microimages are alike on all sides")
    verdict = f"the sensor is farther from the array at the {direction_name(vector)} of the flat"
    if per_number:
        verdict += f": {4 * value:.2g} degrees if the main lens has f/4 (give its f-number)"
    if 2 * np.hypot(*slope) < _LEAST_TILT * radius.value:
        return told(f"{verdict}, by too little to matter")
    if not _is_confirmed(slope, bent, bent_error, seen.field):
        return told(f"{verdict}; neither pitches nor rims confirm it, it may be the light")
    lift = seen.length(2 * reach * float(np.hypot(*vector)))
    away = f", by {lift} over the diagonal of the sensor"
    if per_number:
        away = ""
    return told(
        verdict, f"bring them nearer there, or farther apart at the {direction_name(-vector)}{away}"
    )


def _is_confirmed(slope: Vector, bent: Vector, bent_error: float, field: MicroimageField) -> bool:
    """Whether a change of radii comes from a tilt: pitches or rims change the same way."""

    def turned(one: Vector) -> float:
        return float(one @ slope) / max(float(np.hypot(*one) * np.hypot(*slope)), 1e-12)

    if np.hypot(*bent) > 3 * bent_error:
        return turned(bent) > _SAME_WAY
    blur = np.mean([one.slope for one in field.blur], axis=0)
    error = float(np.mean([one.slope_error for one in field.blur]))
    share = float(np.hypot(*blur) / np.hypot(*(2 * slope)))
    same_way = abs(turned(blur)) > _SAME_WAY_OF_RIMS
    return bool(np.hypot(*blur) > 3 * error and same_way and _RIM_SHARE[0] < share < _RIM_SHARE[1])


def find_distance(seen: Seen) -> Finding:
    """Sharpness of the rims, which are images of the exit pupil at `s = 0`.

    A microlens of the aperture `A` that is focused at `s` blurs the pupil over a disc of the
    diameter `A |s| / D`.
    """
    pitch = seen.camera.lattice.pitch
    blurs = seen.field.blur
    known = seen.camera.lens_blur
    if known is not None and not known.tells_aperture:
        known = None
    value, error = (
        float(np.mean([getattr(blur, name) for blur in blurs])) for name in ("value", "error")
    )
    aperture = pitch if known is None else known.aperture
    sizes = [blur.value * pitch / aperture for blur in blurs]
    details = {
        "disc_px": [b.value for b in blurs],
        "disc_error_px": [b.error for b in blurs],
        "focus_px": sizes,
    }
    told = partial(Finding, value, error, "px", details=details)
    if value <= SURE * error or max(blur.value for blur in blurs) < 1:
        most = max(blur.value + SURE * blur.error for blur in blurs)
        if most < 2:
            return told(
                "rims are sharp: the sensor lies in the focal plane of the microlenses, or these "
                "are stopped down"
            )
        return told(f"rims are blurred over {most:.1f} px at most")
    discs, focus = (
        " / ".join(f"{one:.2g}" for one in ones) for ones in (details["disc_px"], sizes)
    )
    discs += " px (lens types)" if len(blurs) > 1 else " px"
    verdict = f"rims are blurred over {discs}: the microlenses are focused at |s| = {focus} px"
    verdict += (
        ", or at larger ones if they are open over less than their pitch" if known is None else ""
    )
    if seen.f_number is not None:
        # `|b - f| / f` is the disc over the aperture, and `b` the diameter of a microimage times
        # the f-number.
        away = seen.length(2 * seen.field.radius.value * seen.f_number * value / aperture)
        verdict += f"; the sensor is about {away} off their focal plane"
    slope = blurs[0].slope
    if np.hypot(*slope) > max(_APART * blurs[0].slope_error, _LEAST_CHANGE * blurs[0].value):
        verdict += f"; sharper towards the {direction_name(-slope)}"
    return told(verdict)


def find_apertures(seen: Seen) -> Finding:
    lattice = seen.camera.lattice
    radius = seen.field.radius.value
    nearest = 2 * nearest_half(lattice)
    gap = nearest - 2 * radius
    error = 2 * seen.field.radius.error
    ratio = 2 * radius / nearest
    change = f"{ratio:.3g} times its f-number" + (
        f", f/{ratio * seen.f_number:.2g}" if seen.f_number else ""
    )
    half = np.clip(1 / ratio, 0, 1)
    shared = (
        radius**2 * (2 * np.arccos(half) - 2 * half * np.sqrt(1 - half**2)) * len(lattice.steps) / 2
    )
    lost = 1 - ratio**2 if gap > 0 else float(shared / abs(np.linalg.det(lattice.basis)))
    details = {"radii_px": seen.field.radii.mean(0).tolist(), "f_number_ratio": ratio, "lost": lost}
    told = partial(Finding, gap, error, "px", details=details)
    share = f"{abs(gap) / nearest:.1%} of their distance; {lost:.0%} of the sensor"
    if abs(gap) <= max(SURE * error, LEAST_GAP * nearest):
        sure = SURE * error < _SURE_GAP * nearest
        return told(
            "microimages touch: the apertures match"
            if sure
            else "neither a gap nor an overlap is sure"
        )
    if gap > 0:
        verdict = "microimages leave gaps of {} is lost by it"
        advice = "open the main lens to {}, and they touch"
    else:
        verdict = "microimages overlap by {} sees two lenses"
        advice = "stop the main lens down to {}"
    return told(verdict.format(share), advice.format(change))
