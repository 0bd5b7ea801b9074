"""Findings about the light of an array: vignetting, exposure, evenness, dirt."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..images.preprocessing import luminance
from ..images.stack import measure_overexposure
from ..lens_blur.microimages import LIGHT_FAULT, Field
from ..runtime.arrays import evenly
from .findings import LEAST_GAP, SURE, Seen, direction_name, unmeasured
from .result import Finding

__all__ = ["find_dirt", "find_evenness", "find_exposure", "find_range", "find_vignetting"]

# [px] smaller defects are the sensor's own.
_SPECK = 9
# [px] Error of the radius of the cutting disc, and of a cut that is not found.
_CUT_FAULT = 0.1
_NO_CUT_FAULT = 0.3
# [radius] Radius in the corners below which stopping the lens down does not help.
_LEAST_LEFT = 0.3
# Rows of a flat on which brightness is measured; share of clipped pixels, level of bright ones.
_ROWS = 1000
_OVEREXPOSED = 0.02
_WELL_EXPOSED = 0.8
# [%] Difference of the light across the field that may be reported as even.
_EVEN = 15
# Defects that are looked at one by one; share of defective pixels that is no dirt; least difference
# of a speck from the same place in other lenses.
_MOST_SPECKS = 200
_MUCH_DIRT = 0.01
_LEAST_SPECK = 0.1


def find_vignetting(seen: Seen) -> Finding:
    """Where the main lens cuts microimages, and how the light falls towards the corners."""
    gain = seen.camera.gain_map
    radius = seen.field.radius.value
    level = _lens_light(seen)
    if gain is None:
        return unmeasured("px", "the calibration has no gain map")
    corner = 1 - float(np.exp(min(level.bend, 0.0))) if np.isfinite(level.bend) else float("nan")
    details = {"corner_light_lost": corner}
    falls = f"; the light falls by {corner:.0%} towards the corners"
    if np.isnan(corner):
        falls = ""
    if not len(gain.cut):
        # Cuts by less are not looked for.
        return Finding(0.0, _NO_CUT_FAULT, "px", f"no microimages are cut{falls}", details=details)
    shift = float(np.hypot(*gain.cut[:2]))
    growth = abs(float(gain.cut[2]))
    limit = float(gain.cut[3])
    depth = radius + shift + growth - limit
    error = float(np.hypot(seen.field.radius.error, _CUT_FAULT))
    if depth <= max(SURE * error, LEAST_GAP * radius):
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
    """Largest value that pixels of a sensor can have; None if it is not known.

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
    if max(flat.max() for flat in flats) >= 1 << 14:
        return 65535.0
    return None


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
    clipped = 0.0
    if brightest >= top:
        clipped = float((flat >= top).mean())
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
    return told(f"of the largest value, {top:g}: well exposed")


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
    field = lattice.field_place(lattice.centres())
    found = Field.fit(field, np.log(gain.light(field)), LIGHT_FAULT)
    apart = np.hypot(*(found.slope - tiles.slope)) / 2
    return found._replace(slope_error=float(np.hypot(found.slope_error, apart)))


def find_evenness(seen: Seen) -> Finding:
    level = _lens_light(seen)
    size = np.array(seen.camera.image_size)
    if not np.isfinite(level.slope_error):
        return unmeasured("%", "too few microimages")
    across = size / (np.hypot(*size) / 2)
    value = 100 * float(np.expm1(np.abs(level.slope) @ across))
    error = 100 * level.slope_error * float(np.hypot(*across))
    if value <= SURE * error or value < 10:
        sure = value + SURE * error < _EVEN
        return Finding(
            value,
            error,
            "%",
            "evenly lit" if sure else "no side is surely brighter than the others",
        )
    advice = "light the white surface evenly, and centre the main lens"
    return Finding(value, error, "%", f"brighter towards the {direction_name(level.slope)}", advice)


def find_dirt(seen: Seen) -> Finding:
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
    seen_dead = "no dead lenses"
    if len(dead):
        seen_dead = f"{len(dead)} dead lenses"
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
    period = 1
    if camera.lens_types is not None:
        period = len(camera.lens_types.cell)
    levels = []
    for step in period * np.array([(-1, 0), (1, 0), (0, -1), (0, 1)]) @ camera.lattice.basis:
        x, y = np.rint(place + step).astype(int).T
        if min(x.min(), y.min()) >= 0 and x.max() < light.shape[1] and y.max() < light.shape[0]:
            levels.append(float(light[y, x].mean()))
    own = float(light[tuple(place.T[::-1])].mean())
    return bool(levels) and abs(own / max(float(np.median(levels)), 1e-9) - 1) > _LEAST_SPECK
