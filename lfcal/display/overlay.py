"""A picture that shows how a calibration fits a flat: circles over its centre and corners, misfit, light."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..camera.calibration import Calibration
from ..lattice.orientation import describe_orientation
from .fit_check import FitCheck, check_fit

__all__ = ["show"]

# Side of a panel, space between panels, height of captions [px].
_PANEL, _SPACE, _CAPTION = 560, 16, 26
_MARGIN = 24
# Crops are enlarged so many times, less only where fewer than this many pitches would fit.
_ZOOM = (3.0, 4.0)
_PITCHES = (2.5, 6.0)
_BACKGROUND, _PAPER, _INK, _FAINT = (24, 26, 30), (38, 41, 47), (232, 234, 237), (130, 136, 146)
_CIRCLE, _CROSS, _ARROW = (0, 190, 255), (255, 190, 40), (255, 120, 90)
# Circles of lens types 0, 1, 2 and 3.
_TYPES = (_CIRCLE, (255, 110, 200), (140, 240, 90), (250, 230, 80))
_DEFECT = (255, 60, 200)
# Residuals are averaged over so many rectangles, and drawn where they are so many times their standard error.
_RECTANGLES = (12, 9)
_CLEAR = 3.0
# Sub-pixel bits of OpenCV's drawing functions.
_BITS = 4


def show(calibration: Calibration, image: ArrayLike) -> NDArray[np.uint8]:
    """Draw the centres and usable circles of a calibration over the centre and the corners of a flat.

    Circles of different lens types have different colours: blue, pink, green, yellow in the order of their numbers.
    Lenses without light are crossed out, defect pixels circled.
    Beside the five crops a panel shows how far nine regions of the flat disagree with the lattice, the residuals of
    the fit over the field, the gain map, and how the light falls off inside a microimage.

    Parameters
    ----------
    calibration : Calibration
    image : (h, w) or (h, w, 3) array_like
        A white image or scene capture of this camera.

    Returns
    -------
    (h, w, 3) uint8
        RGB.

    Raises
    ------
    FlatError
        If the image is not of the size the calibration is for.
    """
    flat = np.asarray(image)
    width, height = calibration.image_size
    fit = check_fit(calibration, flat)
    pitch = calibration.lattice.pitch
    zoom = float(np.clip(_PANEL / (_PITCHES[1] * pitch), *_ZOOM))
    zoom = min(zoom, _PANEL / (_PITCHES[0] * pitch))
    reach = min(_PANEL / zoom, width, height)
    left, top = reach / 2 - 0.5, reach / 2 - 0.5
    right, low = width - 0.5 - reach / 2, height - 0.5 - reach / 2
    middle = ((width - 1) / 2, (height - 1) / 2)
    rows: list[list[tuple[str, tuple[float, float]] | None]] = [
        [("top left", (left, top)), ("centre", middle), ("top right", (right, top))],
        [("bottom left", (left, low)), None, ("bottom right", (right, low))],
    ]
    side = _PANEL + _CAPTION
    head = 84
    canvas = np.empty((head + 2 * (side + _SPACE) + _SPACE, 3 * (_PANEL + _SPACE) + _SPACE, 3), np.uint8)
    canvas[:] = _BACKGROUND
    for line, words in enumerate(_headline(calibration, fit)):
        _text(canvas, words, (_MARGIN, 34 + 30 * line), _INK if line == 0 else _FAINT, 0.75 if line == 0 else 0.6)
    for row, panels in enumerate(rows):
        for column, panel in enumerate(panels):
            x, y = _SPACE + column * (_PANEL + _SPACE), head + row * (side + _SPACE)
            if panel is None:
                canvas[y : y + side, x : x + _PANEL] = _figures(calibration, fit, side)
                continue
            name, place = panel
            canvas[y : y + _PANEL, x : x + _PANEL] = _crop(calibration, flat, np.array(place), _PANEL / reach)
            first = place[0] - reach / 2 + 0.5, place[1] - reach / 2 + 0.5
            words = f"{name}, {_PANEL / reach:.2g} times, from x {first[0]:.0f}, y {first[1]:.0f}"
            _text(canvas, words, (x + 2, y + _PANEL + 19), _FAINT, 0.5)
    return canvas


def _headline(calibration: Calibration, fit: FitCheck) -> list[str]:
    """What the calibration says of itself, and what the flat says of it."""
    lattice = calibration.lattice
    shape, rows, turned = describe_orientation(lattice)
    words = f"{shape}, rows {rows}" if rows != "both ways" else shape
    first = (
        f"{words}, pitch {lattice.pitch:.4f} px, rotation {turned:+.4f} deg, usable radius {lattice.radius:.2f} px, "
        f"{len(lattice)} lenses"
    )
    residual = "" if np.isnan(calibration.residual_rms) else f", residual {calibration.residual_rms:.3f} px RMS"
    off = (
        "the flat does not tell how well it fits"
        if np.isnan(fit.max_offset)
        else f"off this flat by {fit.max_offset:.2f} px"
    )
    size = "{} x {} px".format(*calibration.image_size)
    types = "" if calibration.lens_types is None else f"{calibration.lens_types.count} lens types, "
    second = f"{size}, {types}from {calibration.source}{residual}, confidence {calibration.confidence:.2f}; {off}"
    return [first, second]


def _crop(calibration: Calibration, flat: NDArray[Any], middle: NDArray[np.float64], zoom: float) -> NDArray[np.uint8]:
    """Enlarged piece of the flat around `middle` (2,) [px] with centres and usable circles."""
    import cv2

    lattice = calibration.lattice
    reach = _PANEL / zoom
    start = np.floor(middle - reach / 2).astype(int) - 2
    stop = np.ceil(middle + reach / 2).astype(int) + 3
    start, stop = np.maximum(start, 0), np.minimum(stop, lattice.image_size)
    piece = _stretched(flat[start[1] : stop[1], start[0] : stop[0]])
    # A flat position p lies at zoom * (p - middle) from the middle of the panel.
    half = (_PANEL - 1) / 2
    shift = half - zoom * (middle - start)
    matrix = np.array([[zoom, 0, shift[0]], [0, zoom, shift[1]]])
    panel: Any = cv2.warpAffine(piece, matrix, (_PANEL, _PANEL), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    centres = lattice.centres()
    near = (np.abs(centres - middle) < reach / 2 + lattice.pitch).all(1)
    drawn = half + zoom * (centres[near] - middle)
    types = calibration.lens_types
    kinds = np.zeros(len(drawn), int) if types is None else types.of(lattice.indices()[near]) % len(_TYPES)
    pixels, lenses = calibration.defects.pixels, calibration.defects.lenses
    missing = lattice.points(lenses)
    missing = half + zoom * (missing[(np.abs(missing - middle) < reach / 2 + lattice.pitch).all(1)] - middle)
    marked = half + zoom * (pixels[(np.abs(pixels - middle) < reach / 2).all(1)] - middle)
    radius = zoom * lattice.radius
    arm = float(np.clip(0.12 * radius, 4, 9))
    # Dark below light is seen on any background; blended, it leaves the pixels visible.
    for thickness, share, dark in ((3, 0.45, True), (1, 0.95, False)):
        layer = panel.copy()
        for place in marked:
            cv2.circle(layer, *_fixed(place), _bits(0.8 * zoom + 2), (0, 0, 0) if dark else _DEFECT, thickness,
                       cv2.LINE_AA, _BITS)  # fmt: skip
        for place in missing:
            for step in (np.array([radius, radius]) / np.sqrt(2), np.array([radius, -radius]) / np.sqrt(2)):
                ends = _fixed(place - step)[0], _fixed(place + step)[0]
                cv2.line(layer, *ends, (0, 0, 0) if dark else _DEFECT, thickness + 1, cv2.LINE_AA, _BITS)
        for place, kind in zip(drawn, kinds, strict=True):
            colour = (0, 0, 0) if dark else _TYPES[kind]
            cv2.circle(layer, *_fixed(place), _bits(radius), colour, thickness, cv2.LINE_AA, _BITS)
            for step in (np.array([arm, 0]), np.array([0, arm])):
                ends = _fixed(place - step)[0], _fixed(place + step)[0]
                cv2.line(layer, *ends, (0, 0, 0) if dark else _CROSS, thickness, cv2.LINE_AA, _BITS)
        panel = cv2.addWeighted(layer, share, panel, 1 - share, 0)
    return panel


def _bits(value: float) -> int:
    return round(value * (1 << _BITS))


def _fixed(place: NDArray[np.float64]) -> tuple[tuple[int, int]]:
    return ((_bits(place[0]), _bits(place[1])),)


def _stretched(piece: NDArray[Any]) -> NDArray[np.uint8]:
    """A piece of a flat as RGB (h, w, 3), its darkest and brightest percent to black and white."""
    values = np.nan_to_num(piece.astype(np.float32))
    if values.ndim == 2:
        values = np.repeat(values[..., None], 3, axis=2)
    low, high = np.percentile(values, (1, 99))
    scaled = np.clip((values - low) / max(high - low, 1e-6), 0, 1)
    return np.rint(255 * scaled ** (1 / 1.4)).astype(np.uint8)


def _figures(calibration: Calibration, fit: FitCheck, height: int) -> NDArray[np.uint8]:
    """Panel with the misfit over the field above and the light over the radius below."""
    panel = np.empty((height, _PANEL, 3), np.uint8)
    panel[:] = _PAPER
    half = height // 2
    _draw_misfit(panel[:half], calibration, fit)
    panel[half - 1 : half + 1] = _BACKGROUND
    third = _PANEL * 2 // 5 if calibration.gain_map is not None else 0
    _draw_light(panel[half:, third:], calibration)
    if third:
        _draw_gain(panel[half:, :third], calibration)
    return panel


def _draw_misfit(panel: NDArray[np.uint8], calibration: Calibration, fit: FitCheck) -> None:
    """Arrows from the centres of the lattice to those the pixels show.

    Thick ones, with numbers, for nine regions of this flat; thin ones for the residuals of the fit over the field.
    """
    import cv2

    height, width = panel.shape[:2]
    distance = np.linalg.norm(fit.offset, axis=-1)
    longest = float(np.nanmax(distance)) if np.isfinite(distance).any() else 0.0
    _text(panel, "Offset of the pixels from the lattice", (14, 24), _INK, 0.52)
    field_width, field_height = calibration.image_size
    scale = min((width - 120) / field_width, (height - 104) / field_height)
    corner = np.array([(width - scale * field_width) / 2, 38.0])
    ends = corner + scale * np.array([field_width, field_height])
    cv2.rectangle(panel, *_fixed(corner), *_fixed(ends), _FAINT, 1, cv2.LINE_AA, _BITS)
    _draw_residuals(panel, calibration, corner, scale)
    enlarge = _enlargement(longest, 0.3 * scale * min(field_width, field_height) / 2)
    for place, offset in zip(fit.places.reshape(-1, 2), fit.offset.reshape(-1, 2), strict=True):
        at = corner + scale * (place + 0.5)
        if np.isnan(offset).any():
            _text(panel, "?", (round(at[0]) - 5, round(at[1]) + 6), _FAINT, 0.5)
            continue
        cv2.circle(panel, *_fixed(at), _bits(2), _FAINT, -1, cv2.LINE_AA, _BITS)
        cv2.arrowedLine(panel, *_fixed(at), *_fixed(at + enlarge * offset), _ARROW, 2, cv2.LINE_AA, _BITS, 0.25)
        _text(panel, f"{float(np.hypot(*offset)):.2g}", (round(at[0]) - 14, round(at[1]) + 20), _INK, 0.4)
    words = f"numbers: this flat, px; arrows {enlarge:g} px here per px" if longest > 0 else "no region shows centres"
    _text(panel, words, (14, height - 12), _ARROW, 0.44)


def _draw_residuals(
    panel: NDArray[np.uint8], calibration: Calibration, corner: NDArray[np.float64], scale: float
) -> None:
    """Thin arrows for the residuals of the fit, averaged over rectangles of the field, where they are no mere noise."""
    import cv2

    height = panel.shape[0]
    if calibration.residuals is None:
        _text(panel, "no residuals: single microimages of a scene do not show them", (14, height - 30), _FAINT, 0.44)
        return
    places, mean, error = calibration.residuals.mean_over_grid(calibration.lattice, *_RECTANGLES)
    length = np.hypot(*mean.T)
    clear = length > _CLEAR * error
    room = 0.5 * scale * min(np.array(calibration.image_size) / _RECTANGLES)
    enlarge = _enlargement(float(length[clear].max(initial=0.0)), room)
    for place, offset, seen in zip(places, mean, clear, strict=True):
        at = corner + scale * (place + 0.5)
        cv2.circle(panel, *_fixed(at), _bits(1), _CIRCLE, -1, cv2.LINE_AA, _BITS)
        if seen:
            cv2.arrowedLine(panel, *_fixed(at), *_fixed(at + enlarge * offset), _CIRCLE, 1, cv2.LINE_AA, _BITS, 0.3)
    words = f"thin arrows: residuals of the fit, {enlarge:g} px here per px; {clear.mean():.0%} are above their noise"
    _text(panel, words, (14, height - 30), _CIRCLE, 0.44)


def _enlargement(longest: float, room: float) -> float:
    """A power of ten times 1, 2 or 5 that makes the longest arrow fit the room [px]; 1 where there is none."""
    if longest <= 0:
        return 1.0
    power = 10 ** np.floor(np.log10(room / longest))
    return float(max(f for f in (power, 2 * power, 5 * power) if f * longest <= room))


def _draw_gain(panel: NDArray[np.uint8], calibration: Calibration) -> None:
    """Gain map over the whole field, and enlarged in the top left corner; unknown places in their own colour."""
    import cv2

    height, width = panel.shape[:2]
    _text(panel, "Gain map", (14, 24), _INK, 0.52)
    gain = calibration.gain()
    side = min(height - 70, width - 28)
    rows = (height - 70 - 8) // 2
    scale = min(side / gain.shape[1], rows / gain.shape[0])
    small = max(1, int(scale * gain.shape[1])), max(1, int(scale * gain.shape[0]))
    # Gaps are left out of the mean over the pixels that share one of the picture.
    known = cv2.resize(np.isfinite(gain).astype(np.float32), small, interpolation=cv2.INTER_AREA)
    light = cv2.resize(np.nan_to_num(gain), small, interpolation=cv2.INTER_AREA) / np.maximum(known, 1e-6)
    reach = max(8, int(4 * calibration.lattice.pitch))
    corner = gain[:reach, :reach]
    enlarged = cv2.resize(corner, (rows, rows), interpolation=cv2.INTER_NEAREST)
    for values, top in ((np.where(known > 0, light, np.nan), 34), (enlarged, 42 + rows)):
        grey = np.rint(255 * np.clip(np.nan_to_num(values), 0, 1)).astype(np.uint8)
        drawn = np.repeat(grey[..., None], 3, axis=2)
        drawn[np.isnan(values)] = (60, 20, 50)
        panel[top : top + drawn.shape[0], 14 : 14 + drawn.shape[1]] = drawn
    defects = calibration.defects
    words = f"{len(defects.pixels)} pixels, {len(defects.lenses)} lenses defect"
    _text(panel, words, (14, height - 12), _DEFECT, 0.4)


def _draw_light(panel: NDArray[np.uint8], calibration: Calibration) -> None:
    """Relative illumination over the distance to the centre, and the usable radius."""
    import cv2

    height, width = panel.shape[:2]
    _text(panel, "Light inside a microimage", (14, 24), _INK, 0.52)
    vignetting, radius = calibration.vignetting, calibration.lattice.radius
    if vignetting is None:
        _text(panel, "not measured", (14, 54), _FAINT, 0.5)
        return
    low, high = np.array([52.0, height - 46.0]), np.array([width - 20.0, 44.0])
    radii = np.arange(len(vignetting.profile)) * vignetting.step
    end = max(float(radii[-1]), 1.05 * radius)

    def at(r: float, light: float) -> NDArray[np.float64]:
        return low + (high - low) * [r / end, light]

    for level in (0, 0.5, 1):
        cv2.line(panel, *_fixed(at(0, level)), *_fixed(at(end, level)), (70, 74, 82), 1, cv2.LINE_AA, _BITS)
        _text(panel, f"{level:g}", (16, round(at(0, level)[1]) + 5), _FAINT, 0.42)
    cv2.line(panel, *_fixed(at(radius, 0)), *_fixed(at(radius, 1)), _CIRCLE, 1, cv2.LINE_AA, _BITS)
    _text(panel, f"R {radius:.1f}", (round(at(radius, 0)[0]) - 54, round(at(0, 0)[1]) - 8), _CIRCLE, 0.42)
    curve = np.array([[_bits(v) for v in at(r, p)] for r, p in zip(radii, vignetting.profile, strict=True)], np.int32)
    cv2.polylines(panel, [curve], False, _CROSS, 2, cv2.LINE_AA, _BITS)
    for share in (0, 0.5, 1):
        place = at(share * end, 0)
        _text(panel, f"{share * end:.1f}", (round(place[0]) - 14 * (share > 0), round(place[1]) + 18), _FAINT, 0.42)
    _text(panel, "distance to the centre [px]", (width // 2 - 100, height - 8), _FAINT, 0.44)


def _text(canvas: NDArray[np.uint8], words: str, place: tuple[int, int], colour: tuple[int, ...], size: float) -> None:
    import cv2

    cv2.putText(canvas, words, place, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)
