"""Findings from measurements: values with errors, verdicts, and advice."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..gain.gain_map import field_place, nearest_half
from ..images.preprocessing import luminance
from ..images.stack import measure_overexposure
from ..lens_blur.microimages import LIGHT_FAULT, Field, MicroimageField
from ..runtime.arrays import evenly
from .alignment import Alignment
from .result import Finding

__all__ = [
    "FINDINGS",
    "Seen",
    "find_exposure",
    "find_range",
    "find_rotation",
    "find_tilt",
    "unmeasured",
]

Vector = NDArray[np.float64]
# [standard errors] within which a value counts as zero, and from which on two measurements
# contradict each other.
_SURE = 2.0
_APART = 4.0
# [px] smaller defects are the sensor's own.
_SPECK = 9
# Error of the radii where microimages overlap [px]: up to 0.21 on simulated cameras.
_OVERLAP_FAULT = 0.15
# [radius] Twice the change of the radii per half diagonal that is too little to matter.
_LEAST_TILT = 0.01
# Correlations with the change of the radii at which pitches or rims confirm a tilt, and the change
# of the rims over that of the radii.
_SAME_WAY = 0.7
_SAME_WAY_OF_RIMS = 0.8
_RIM_SHARE = (0.15, 1.5)
# [rim blur] Change of the rims over the field that is told.
_LEAST_CHANGE = 0.1
# [pitch], [radius] Gaps and cuts that are told, and errors of gaps that are small.
_LEAST_GAP = 0.02
_SURE_GAP = 0.05
# [px] Error of the radius of the cutting disc, and of a cut that is not found.
_CUT_FAULT = 0.1
_NO_CUT_FAULT = 0.3
# [radius] Radius in the corners below which stopping the lens down does not help.
_LEAST_LEFT = 0.3
# Rows of a flat that tell its brightness; share of clipped pixels, and level of bright ones.
_ROWS = 1000
_OVEREXPOSED = 0.02
_WELL_EXPOSED = 0.8
# [%] Difference of the light across the field that may be told as even.
_EVEN = 15
# Defects that are looked at one by one; share of defective pixels that is no dirt; least difference
# of a speck from the same place in other lenses.
_MOST_SPECKS = 200
_MUCH_DIRT = 0.01
_LEAST_SPECK = 0.1
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
        return f"{pixels:.2g} px" if self.pixel is None else f"{1000 * pixels * self.pixel:.2g} um"


def unmeasured(unit: str, why: str) -> Finding:
    """A finding without a value."""
    return Finding(float("nan"), float("nan"), unit, f"not measured: {why}")


def _way(vector: Vector) -> str:
    return _WAYS[round(float(np.arctan2(vector[1], vector[0])) / (np.pi / 4)) % 8]


def find_rotation(found: Alignment, camera: Calibration) -> Finding:
    """Rotation of the rows of lenses."""
    value = found.rotation
    error = found.rotation_error
    told = partial(
        Finding, value, error, "degrees", details={"lattice": found.shape, "rows": found.rows}
    )
    rows = "the rows of lenses" if found.rows == "both ways" else f"the {found.rows} rows of lenses"
    drift = abs(np.radians(value)) * max(camera.image_size)
    if not np.isfinite(error):
        return told("its error is not known, so there is no advice")
    if drift < 0.5:
        return told(f"{rows} lie along those of the sensor")
    if abs(value) <= _SURE * error:
        return told(f"{rows} are not turned by more than {abs(value) + _SURE * error:.2g} degrees")
    here, back = ("clockwise", "counter-clockwise")[:: 1 if value > 0 else -1]
    return told(
        f"{rows} are turned {here} on the flat, by {drift:.1f} px over it",
        f"to align them turn the array by {abs(value):.3g} degrees {back} as it looks on the "
        f"flat, that is {here} seen "
        "from the main lens (unless the camera mirrors its flats)",
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
    unit = "degrees per f-number" if per_number else "degrees"
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
    if value <= _SURE * error:
        limit = "" if per_number else f" larger than {_SURE * error:.2g} degrees"
        return told(f"no tilt{limit} is seen: microimages are alike on all sides")
    verdict = f"the sensor is farther from the array at the {_way(vector)} of the flat"
    if per_number:
        verdict += f": {4 * value:.2g} degrees if the main lens has f/4 (give its f-number)"
    if 2 * np.hypot(*slope) < _LEAST_TILT * radius.value:
        return told(f"{verdict}, by too little to matter")
    if not _is_confirmed(slope, bent, bent_error, seen.field):
        return told(f"{verdict}; neither pitches nor rims confirm it, it may be the light")
    lift = seen.length(2 * reach * float(np.hypot(*vector)))
    away = "" if per_number else f", by {lift} over the diagonal of the sensor"
    return told(verdict, f"bring them nearer there, or farther apart at the {_way(-vector)}{away}")


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


def _find_distance(seen: Seen) -> Finding:
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
    if value <= _SURE * error or max(blur.value for blur in blurs) < 1:
        most = max(blur.value + _SURE * blur.error for blur in blurs)
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
        verdict += f"; sharper towards the {_way(-slope)}"
    return told(verdict)


def _find_apertures(seen: Seen) -> Finding:
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
    if abs(gap) <= max(_SURE * error, _LEAST_GAP * nearest):
        sure = _SURE * error < _SURE_GAP * nearest
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


def _find_vignetting(seen: Seen) -> Finding:
    """Where the main lens cuts microimages, and how the light falls towards the corners."""
    gain = seen.camera.gain_map
    radius = seen.field.radius.value
    level = _lens_light(seen)
    if gain is None:
        return unmeasured("px", "the calibration has no gain map")
    corner = 1 - float(np.exp(min(level.bend, 0.0))) if np.isfinite(level.bend) else float("nan")
    details = {"corner_light_lost": corner}
    falls = "" if np.isnan(corner) else f"; the light falls by {corner:.0%} towards the corners"
    if not len(gain.cut):
        # Cuts by less are not looked for.
        return Finding(0.0, _NO_CUT_FAULT, "px", f"no microimages are cut{falls}", details=details)
    shift = float(np.hypot(*gain.cut[:2]))
    growth = abs(float(gain.cut[2]))
    limit = float(gain.cut[3])
    depth = radius + shift + growth - limit
    error = float(np.hypot(seen.field.radius.error, _CUT_FAULT))
    if depth <= max(_SURE * error, _LEAST_GAP * radius):
        return Finding(
            max(depth, 0.0), error, "px", f"no microimages are cut by more{falls}", details=details
        )
    begins = details["begins_at"] = float(np.clip((limit - radius - shift) / growth, 0, 1))
    verdict = f"microimages are cut from {begins:.0%} of the way to the corners on{falls}"
    most = limit - growth - shift
    advice = f"stop the main lens down to {radius / most:.2g} times its f-number, and all are whole"
    return Finding(
        depth, error, "px", verdict, advice if most > _LEAST_LEFT * radius else "", details
    )


def find_range(flats: list[NDArray[Any]], white_level: float | None = None) -> float | None:
    """Largest value that pixels of a sensor can have; None if nothing tells it.

    Files of 16 bits hold sensors of 10, 12 or 14 bits too. A dim flat does not show which.
    """
    if white_level is not None:
        return white_level
    if any(flat.dtype.kind != "u" for flat in flats):
        return None
    if any(flat.dtype.itemsize == 1 for flat in flats):
        return 255.0
    if any(measure_overexposure(flat) > 0 for flat in flats):
        return float(max(flat.max() for flat in flats))
    return 65535.0 if max(flat.max() for flat in flats) >= 1 << 14 else None


def find_exposure(flat: NDArray[Any], top: float | None) -> Finding:
    """Over- or under-exposed, where the largest value `top` that pixels can have is known."""
    brightest = float(flat.max())
    if flat.dtype.kind == "f" and top is None:
        return unmeasured(
            "%", "values that are no whole numbers have no largest one; give the white level"
        )
    if top is None:
        ranges = "10, 12, 14 or 16 bits"
        return unmeasured(
            "%",
            f"{ranges}, nothing tells which: the brightest pixel is {brightest:g}; give "
            "--white-level",
        )
    bright = float(np.percentile(flat[evenly(len(flat), _ROWS)], 99)) / top
    clipped = float((flat >= top).mean()) if brightest >= top else 0.0
    told = partial(
        Finding, 100 * bright, 0.0, "%", details={"clipped": clipped, "white_level": top}
    )
    if clipped > _OVEREXPOSED:
        return told(
            f"over-exposed: {clipped:.0%} of the pixels are at {top:g}",
            "expose less, by a half or more",
        )
    if bright < 0.25:
        longer = f"expose up to {_WELL_EXPOSED / max(bright, 1e-6):.2g} times longer"
        return told(f"under-exposed: bright pixels have {bright:.1%} of {top:g}", longer)
    return told(f"of {top:g}: well exposed")


def _lens_light(seen: Seen) -> Field:
    """Logarithm of the light of the lenses over the field, as the page draws it.

    Where there is no gain map, that of the tiles. Half the difference of both is part of the error
    of the slope.
    """
    tiles = seen.field.level
    gain = seen.camera.gain_map
    lattice = seen.camera.lattice
    if gain is None:
        return Field(*tiles)
    centres = lattice.centres()
    found = Field.fit(
        field_place(centres, lattice), np.log(gain.light(centres, lattice)), LIGHT_FAULT
    )
    apart = np.hypot(*(found.slope - tiles.slope)) / 2
    return found._replace(slope_error=float(np.hypot(found.slope_error, apart)))


def _find_evenness(seen: Seen) -> Finding:
    level = _lens_light(seen)
    size = np.array(seen.camera.image_size)
    if not np.isfinite(level.slope_error):
        return unmeasured("%", "too few microimages")
    across = size / (np.hypot(*size) / 2)
    value = 100 * float(np.expm1(np.abs(level.slope) @ across))
    error = 100 * level.slope_error * float(np.hypot(*across))
    if value <= _SURE * error or value < 10:
        sure = value + _SURE * error < _EVEN
        return Finding(
            value,
            error,
            "%",
            "evenly lit" if sure else "no side is surely brighter than the others",
        )
    advice = "light the white surface evenly, and centre the main lens"
    return Finding(value, error, "%", f"brighter towards the {_way(level.slope)}", advice)


def _find_dirt(seen: Seen) -> Finding:
    """Specks of defective pixels, and dead lenses, where all lenses around are lit and whole."""
    import cv2

    from ..detection.downscale import LARGE

    flat = seen.flat
    lattice = seen.camera.lattice
    defects = seen.camera.defects
    index = lattice.indices()
    low = index.min(0) - 4
    lit = np.zeros(index.max(0) - low + 5, np.uint8)
    lit[tuple((index - low).T)] = 1
    lit[tuple((defects.lenses - low).T)] = 0
    # Beyond the light there are many dark lenses side by side; closing leaves those of three by
    # three and more.
    inside = (
        cv2.erode(
            cv2.morphologyEx(lit, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)),
            np.ones((5, 5), np.uint8),
        )
        > 0
    )
    dead = defects.lenses[inside[tuple((defects.lenses - low).T)]]
    seen_dead = f"{len(dead)} dead lenses" if len(dead) else "no dead lenses"
    if flat.shape[0] * flat.shape[1] >= LARGE:
        return Finding(
            len(dead),
            0.0,
            "places",
            f"{seen_dead}; pixels of flats as large as this are not looked at",
        )
    mask = np.zeros(flat.shape[:2], np.uint8)
    mask[defects.pixels[:, 1], defects.pixels[:, 0]] = 1
    _, label, stats, middle = cv2.connectedComponentsWithStats(mask, connectivity=8)
    area = stats[:, cv2.CC_STAT_AREA]
    light = luminance(flat)
    large = 1 + np.flatnonzero(area[1:] >= _SPECK)
    home = np.clip(
        np.rint(lattice.to_index(middle[large])).astype(np.int64) - low,
        0,
        np.array(inside.shape) - 1,
    )
    large = large[inside[tuple(home.T)]]
    specks = [
        k
        for k in large[np.argsort(-area[large])][:_MOST_SPECKS]
        if _is_seen(light, label, k, stats[k], seen.camera)
    ]
    count = len(specks) + len(dead)
    share = len(defects.pixels) / mask.size
    told = partial(
        Finding,
        count,
        0.0,
        "places",
        details={"pixels": len(defects.pixels), "dead_lenses": len(dead)},
    )
    if share > _MUCH_DIRT:
        return told(
            f"{share:.1%} of the pixels are defective: much dirt, or an uneven white surface"
        )
    single = int((area[1:] < _SPECK).sum())
    verdict = f"{len(specks)} specks, {seen_dead}, {single} single pixels of the sensor"
    if specks:
        x, y = middle[specks[0]].round().astype(int)
        return told(
            verdict,
            f"clean array and sensor: the largest speck ({area[specks[0]]} px) is at x {x}, y {y}",
        )
    if len(dead):
        x, y = lattice.points(dead[:1])[0].round().astype(int)
        return told(verdict, f"look at the lens at x {x}, y {y}")
    return told(verdict if single else "clean")


def _is_seen(
    light: NDArray[np.float32],
    label: NDArray[Any],
    number: int,
    box: NDArray[Any],
    camera: Calibration,
) -> bool:
    """Whether a speck differs by 10 % from the same place in lenses around, of its type."""
    left, top, wide, high = box[:4]
    place = np.argwhere(label[top : top + high, left : left + wide] == number)[:, ::-1] + (
        left,
        top,
    )
    period = 1 if camera.lens_types is None else len(camera.lens_types.cell)
    levels = []
    for step in period * np.array([(-1, 0), (1, 0), (0, -1), (0, 1)]) @ camera.lattice.basis:
        x, y = np.rint(place + step).astype(int).T
        if min(x.min(), y.min()) >= 0 and x.max() < light.shape[1] and y.max() < light.shape[0]:
            levels.append(float(light[y, x].mean()))
    own = float(light[tuple(place.T[::-1])].mean())
    return bool(levels) and abs(own / max(float(np.median(levels)), 1e-9) - 1) > _LEAST_SPECK


#: What takes a white image and a calibration made from it: what finds each, its unit, whether it
#: takes rims.
FINDINGS: dict[str, tuple[Callable[[Seen], Finding], str, bool]] = {
    "tilt": (find_tilt, "degrees", True),
    "distance": (_find_distance, "px", True),
    "apertures": (_find_apertures, "px", True),
    "vignetting": (_find_vignetting, "px", True),
    "exposure": (lambda seen: find_exposure(seen.flat, seen.top), "%", False),
    "evenness": (_find_evenness, "%", True),
    "dirt": (_find_dirt, "places", False),
}
