"""From what was measured to findings: values with errors, verdicts, and advice where both are sure enough."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..gain.gain_map import nearest_half
from ..images.preprocessing import luminance
from ..images.stack import estimate_white_level, measure_overexposure
from ..lattice.lattice import Lattice
from .alignment import Alignment
from .microimages import MicroimageField
from .result import Finding

__all__ = [
    "Optics", "find_apertures", "find_dirt", "find_distance", "find_evenness", "find_exposure", "find_rotation",
    "find_tilt", "find_vignetting", "unmeasured",
]  # fmt: skip

Vector = NDArray[np.float64]
# [standard errors] within which a value counts as zero, and from which on two measurements contradict each other.
_SURE = 2.0
_APART = 4.0
# [px] smaller defects are the sensor's own.
_SPECK = 9
_WAYS = ("right", "lower right", "bottom", "lower left", "left", "upper left", "top", "upper right")


@dataclass(frozen=True)
class Optics:
    """What is known of the main lens: f-number as seen from the sensor, distance [px] of its exit pupil, pixel [mm]."""

    f_number: float | None = None
    pupil: float | None = None
    pixel: float | None = None

    def length(self, pixels: float) -> str:
        """A distance in the unit that is known."""
        return f"{pixels:.2g} px" if self.pixel is None else f"{1000 * pixels * self.pixel:.2g} um"


def unmeasured(unit: str, why: str) -> Finding:
    """A finding without a value."""
    return Finding(float("nan"), float("nan"), unit, f"not measured: {why}")


def _way(vector: Vector) -> str:
    return _WAYS[round(float(np.arctan2(vector[1], vector[0])) / (np.pi / 4)) % 8]


def find_rotation(found: Alignment, lattice: Lattice) -> Finding:
    """Rotation of the rows of lenses."""
    value, error = found.rotation, found.rotation_error
    told = partial(Finding, value, error, "degrees", details={"lattice": found.shape, "rows": found.rows})
    if not np.isfinite(error):
        return told("its error is not known, so there is no advice")
    drift = abs(np.radians(value)) * max(lattice.image_size)
    rows = "the rows of lenses" if found.rows == "both ways" else f"the {found.rows} rows of lenses"
    if drift < 0.5:
        return told(f"{rows} lie along those of the sensor")
    if abs(value) <= _SURE * error:
        return told(f"{rows} are not turned by more than {abs(value) + _SURE * error:.2g} degrees")
    here, back = ("clockwise", "counter-clockwise")[:: 1 if value > 0 else -1]
    verdict = f"{rows} are turned {here} on the flat, by {drift:.1f} px over it"
    advice = (
        f"to align them turn the array by {abs(value):.3g} degrees {back} as it looks on the flat, that is {here} seen "
        "from the main lens (unless the camera mirrors its flats)"
    )
    return told(verdict, advice)


def find_tilt(found: Alignment, field: MicroimageField | None, lattice: Lattice, optics: Optics) -> Finding:
    """Tilt of the sensor against the array, from radii (by the f-number) and pitches (by the distance of the pupil).

    A microimage has the radius `b / 2N`: a tilt `g` changes it by `g / 2N` per pixel.
    """
    reach = float(np.hypot(*lattice.image_size)) / 2
    number, pupil = optics.f_number, optics.pupil
    bent, bent_error = found.gradient, found.gradient_error
    if field is None or not np.isfinite(field.radius.slope_error):
        slope, slope_error = np.full(2, np.nan), float("inf")
    else:
        slope, slope_error = field.radius.slope, field.radius.slope_error
        if field.radius.value > nearest_half(lattice):
            # Rims that are measured in the light of neighbours: up to 0.21 px on simulated cameras.
            bent_error = float(np.hypot(bent_error, 0.15))
    by = []
    if np.isfinite(slope_error):
        by.append((2 * slope / reach * (number or 1.0), 2 * slope_error / reach * (number or 1.0)))
    if np.isfinite(bent_error) and pupil is not None and (number is not None or not by):
        by.append((bent / reach**2 * pupil, bent_error / reach**2 * pupil))
    if not by:
        return unmeasured("degrees", "too few microimages with rims, and the distance of the pupil is not given")
    per_number = number is None and np.isfinite(slope_error)
    weight = np.array([1 / error**2 for _, error in by])
    vector = sum(w * one for w, (one, _) in zip(weight, by, strict=True)) / weight.sum()
    error = float(np.degrees(weight.sum() ** -0.5))
    value, unit = float(np.degrees(np.hypot(*vector))), "degrees per f-number" if per_number else "degrees"
    to_right, to_bottom = np.degrees(vector).tolist()
    told = partial(Finding, value, error, unit, details={"to_right": to_right, "to_bottom": to_bottom})
    if len(by) == 2 and np.hypot(*(by[0][0] - by[1][0])) > _APART * np.hypot(by[0][1], by[1][1]):
        return told("radii and pitches tell different tilts: the main lens distorts or cuts microimages on one side")
    if value <= _SURE * error:
        limit = "" if per_number else f" larger than {_SURE * error:.2g} degrees"
        return told(f"no tilt{limit} is seen: microimages are alike on all sides")
    verdict = f"the sensor is farther from the array at the {_way(vector)} of the flat"
    if per_number:
        verdict += f": {4 * value:.2g} degrees if the main lens has f/4 (give its f-number)"
    if field is not None and 2 * np.hypot(*slope) < 0.01 * field.radius.value:
        return told(f"{verdict}, by too little to matter")
    if field is not None and not _is_confirmed(slope, bent, bent_error, field):
        return told(f"{verdict}; neither pitches nor rims confirm it, it may be the light")
    lift = 2 * reach * float(np.hypot(*vector))
    away = f", by {optics.length(lift)} over the diagonal of the sensor" if not per_number else ""
    return told(verdict, f"bring them nearer there, or farther apart at the {_way(-vector)}{away}")


def _is_confirmed(slope: Vector, bent: Vector, bent_error: float, field: MicroimageField) -> bool:
    """Whether radii that change by `slope` [px] do so by a tilt: pitches grow that way too, or rims get softer that way
    or the other, by a sixth to one and a half of what microimages get wider."""

    def turned(one: Vector) -> float:
        return float(one @ slope) / max(float(np.hypot(*one) * np.hypot(*slope)), 1e-12)

    if np.hypot(*bent) > 3 * bent_error:
        return turned(bent) > 0.7
    blur = np.mean([one.slope for one in field.blur], axis=0)
    error = float(np.mean([one.slope_error for one in field.blur]))
    share = float(np.hypot(*blur) / np.hypot(*(2 * slope)))
    return bool(np.hypot(*blur) > 3 * error and abs(turned(blur)) > 0.8 and 0.15 < share < 1.5)


def find_distance(field: MicroimageField | None, camera: Calibration, optics: Optics) -> Finding:
    """Sharpness of the rims, which are images of the exit pupil at `s = 0`: what the microlenses are focused at.

    A microlens of the aperture `A` that is focused at `s` blurs the pupil over a disc of the diameter `A |s| / D`.
    """
    if field is None:
        return unmeasured("px", "the microimages show no rims")
    pitch, blurs = camera.lattice.pitch, field.blur
    value, error = (float(np.mean([getattr(blur, name) for blur in blurs])) for name in ("value", "error"))
    discs = " / ".join(f"{blur.value:.2g}" for blur in blurs) + (" px (lens types)" if len(blurs) > 1 else " px")
    aperture = camera.lens_blur.aperture if camera.lens_blur is not None else pitch
    sizes = [blur.value * pitch / aperture for blur in blurs]
    details = {"disc_px": [b.value for b in blurs], "disc_error_px": [b.error for b in blurs], "focus_px": sizes}
    told = partial(Finding, value, error, "px", details=details)
    if value <= _SURE * error or max(blur.value for blur in blurs) < 1:
        most = max(blur.value + _SURE * blur.error for blur in blurs)
        verdict = f"rims are blurred over {most:.1f} px at most"
        if most < 2:
            verdict = "rims are sharp: the sensor lies in the focal plane of the microlenses, or these are stopped down"
        return told(verdict)
    sizes_told = " / ".join(f"{size:.2g}" for size in sizes)
    least = "" if camera.lens_blur is not None else ", or at larger ones if they are open over less than their pitch"
    verdict = f"rims are blurred over {discs}: the microlenses are focused at |s| = {sizes_told} px{least}"
    if optics.f_number is not None:
        # `|b - f| / f` is the disc over the aperture, and `b` the diameter of a microimage times the f-number.
        away = optics.length(2 * field.radius.value * optics.f_number * value / aperture)
        verdict += f"; the sensor is about {away} off their focal plane"
    slope = blurs[0].slope
    if np.hypot(*slope) > max(_APART * blurs[0].slope_error, 0.1 * blurs[0].value):
        verdict += f"; sharper towards the {_way(-slope)}"
    return told(verdict)


def find_apertures(field: MicroimageField | None, lattice: Lattice, optics: Optics) -> Finding:
    """Gap or overlap of neighbouring microimages."""
    if field is None:
        return unmeasured("px", "the microimages show no rims")
    nearest, radius = 2 * nearest_half(lattice), field.radius.value
    gap, error, ratio = nearest - 2 * radius, 2 * field.radius.error, 2 * radius / nearest
    change = f"{ratio:.3g} times its f-number" + (f", f/{ratio * optics.f_number:.2g}" if optics.f_number else "")
    half = np.clip(1 / ratio, 0, 1)
    shared = radius**2 * (2 * np.arccos(half) - 2 * half * np.sqrt(1 - half**2)) * len(lattice.steps) / 2
    lost = 1 - ratio**2 if gap > 0 else float(shared / abs(np.linalg.det(lattice.basis)))
    details = {"radii_px": field.radii.mean(0).tolist(), "f_number_ratio": ratio, "lost": lost}
    told = partial(Finding, gap, error, "px", details=details)
    if abs(gap) <= max(_SURE * error, 0.02 * nearest):
        sure = _SURE * error < 0.05 * nearest
        return told("microimages touch: the apertures match" if sure else "neither a gap nor an overlap is sure")
    share = f"{abs(gap) / nearest:.1%} of their distance; {lost:.0%} of the sensor"
    if gap > 0:
        return told(
            f"microimages leave gaps of {share} is lost by it", f"open the main lens to {change}, and they touch"
        )
    return told(f"microimages overlap by {share} sees two lenses", f"stop the main lens down to {change}")


def find_vignetting(field: MicroimageField | None, camera: Calibration) -> Finding:
    """Where the main lens cuts microimages, and how the light falls towards the corners."""
    gain = camera.gain_map
    if field is None or gain is None:
        return unmeasured("px", "the microimages show no rims")
    radius = field.radius.value
    corner = 1 - float(np.exp(min(field.level.bend, 0.0))) if np.isfinite(field.level.bend) else float("nan")
    details = {"corner_light_lost": corner}
    falls = "" if np.isnan(corner) else f"; the light falls by {corner:.0%} towards the corners"
    if not len(gain.cut):
        # Cuts by less are not looked for.
        return Finding(0.0, 0.3, "px", f"no microimages are cut{falls}", details=details)
    shift, growth, limit = float(np.hypot(*gain.cut[:2])), abs(float(gain.cut[2])), float(gain.cut[3])
    depth, error = radius + shift + growth - limit, float(np.hypot(field.radius.error, 0.1))
    if depth <= max(_SURE * error, 0.02 * radius):
        return Finding(max(depth, 0.0), error, "px", f"no microimages are cut by more{falls}", details=details)
    begins = details["begins_at"] = float(np.clip((limit - radius - shift) / growth, 0, 1))
    verdict = f"microimages are cut from {begins:.0%} of the way to the corners on{falls}"
    most = limit - growth - shift
    advice = f"stop the main lens down to {radius / most:.2g} times its f-number, and all are whole"
    return Finding(depth, error, "px", verdict, advice if most > 0.3 * radius else "", details)


def find_exposure(flat: NDArray[Any], camera: Calibration) -> Finding:
    """Over- or under-exposed."""
    if flat.dtype.kind != "u":
        return unmeasured("%", "values that are no whole numbers have no largest one")
    top = estimate_white_level([flat]) or float(np.iinfo(flat.dtype).max)
    if camera.white_level is not None and flat.max() <= camera.white_level:
        top = camera.white_level
    values = flat[:: max(1, len(flat) // 1000)]
    bright, clipped = float(np.percentile(values, 99)) / top, measure_overexposure(flat)
    told = partial(Finding, 100 * bright, 50 / top, "%", details={"clipped": clipped})
    if clipped > 0.02:
        return told(f"over-exposed: {clipped:.0%} of the pixels are clipped", "expose less, by a half or more")
    if bright < 0.25:
        longer = f"expose up to {0.8 / max(bright, 1e-4):.2g} times longer"
        return told(f"under-exposed: bright pixels have {bright:.1%} of the largest value", longer)
    return told("well exposed")


def find_evenness(field: MicroimageField | None, lattice: Lattice) -> Finding:
    """Light over the field, without what falls off alike on all sides."""
    if field is None or not np.isfinite(field.level.slope_error):
        return unmeasured("%", "too few microimages")
    across = np.array(lattice.image_size) / (np.hypot(*lattice.image_size) / 2)
    value = 100 * float(np.expm1(np.abs(field.level.slope) @ across))
    error = 100 * field.level.slope_error * float(np.hypot(*across))
    if value <= _SURE * error or value < 10:
        sure = value + _SURE * error < 15
        return Finding(value, error, "%", "evenly lit" if sure else "no side is surely brighter than the others")
    advice = "light the white surface evenly, and centre the main lens"
    return Finding(value, error, "%", f"brighter towards the {_way(field.level.slope)}", advice)


def find_dirt(flat: NDArray[Any], camera: Calibration) -> Finding:
    """Specks of defective pixels, and dead lenses, where all lenses around are lit and whole."""
    import cv2

    from ..detection.downscale import LARGE

    lattice, defects = camera.lattice, camera.defects
    index = lattice.indices()
    low = index.min(0) - 4
    dark, known = np.zeros((2, *(index.max(0) - low + 5)), np.uint8)
    known[tuple((index - low).T)] = 1
    dark[tuple((defects.lenses - low).T)] = 1
    # Beyond the light there are many dark lenses side by side.
    _, label, stats, _ = cv2.connectedComponentsWithStats(dark, connectivity=8)
    outside = (stats[label, cv2.CC_STAT_AREA] > 9) & (dark > 0) | (known == 0)
    inside = cv2.erode((~outside).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    dead = defects.lenses[inside[tuple((defects.lenses - low).T)]]
    seen = f"{len(dead)} dead lenses" if len(dead) else "no dead lenses"
    if flat.shape[0] * flat.shape[1] >= LARGE:
        return Finding(len(dead), 0.0, "places", f"{seen}; pixels of flats as large as this are not looked at")
    mask = np.zeros(flat.shape[:2], np.uint8)
    mask[defects.pixels[:, 1], defects.pixels[:, 0]] = 1
    _, label, stats, middle = cv2.connectedComponentsWithStats(mask, connectivity=8)
    area, light = stats[:, cv2.CC_STAT_AREA], luminance(flat)
    large = 1 + np.flatnonzero(area[1:] >= _SPECK)
    home = np.clip(np.rint(lattice.to_index(middle[large])).astype(np.int64) - low, 0, np.array(inside.shape) - 1)
    large = large[inside[tuple(home.T)]]
    specks = [k for k in large[np.argsort(-area[large])][:200] if _is_seen(light, label, k, stats[k], camera)]
    count, share = len(specks) + len(dead), len(defects.pixels) / mask.size
    told = partial(Finding, count, 0.0, "places", details={"pixels": len(defects.pixels), "dead_lenses": len(dead)})
    if share > 0.01:
        return told(f"{share:.1%} of the pixels differ from their like: much dirt, or an uneven white surface")
    single = int((area[1:] < _SPECK).sum())
    verdict = f"{len(specks)} specks, {seen}, {single} single pixels of the sensor"
    if specks:
        x, y = middle[specks[0]].round().astype(int)
        return told(verdict, f"clean array and sensor: the largest speck ({area[specks[0]]} px) is at x {x}, y {y}")
    if len(dead):
        x, y = lattice.points(dead[:1])[0].round().astype(int)
        return told(verdict, f"look at the lens at x {x}, y {y}")
    return told(verdict if single else "clean")


def _is_seen(
    light: NDArray[np.float32], label: NDArray[Any], number: int, box: NDArray[Any], camera: Calibration
) -> bool:
    """Whether a speck is darker or brighter by 10 % than the same place of lenses around it, of the same type."""
    left, top, wide, high = box[:4]
    y, x = np.nonzero(label[top : top + high, left : left + wide] == number)
    x, y, (height, width) = x + left, y + top, light.shape
    period = 1 if camera.lens_types is None else len(camera.lens_types.cell)
    ratios = []
    for step in period * np.array([(-1, 0), (1, 0), (0, -1), (0, 1)]) @ camera.lattice.basis:
        u, v = np.rint(x + step[0]).astype(int), np.rint(y + step[1]).astype(int)
        if min(u.min(), v.min()) >= 0 and u.max() < width and v.max() < height:
            ratios.append(float(light[y, x].mean()) / max(float(light[v, u].mean()), 1e-9))
    return bool(ratios) and abs(float(np.median(ratios)) - 1) > 0.1
