"""Panels of figures beside the crops of `show`: misfit over the flat, gain map, light falloff."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..lattice.settings import DEFAULT
from .drawing import Canvas
from .fit_check import FitCheck
from .settings import STYLE

__all__ = ["draw_figures"]


def draw_figures(calibration: Calibration, fit: FitCheck, height: int) -> NDArray[np.uint8]:
    """Panel with the misfit over the flat above, and gain map and light falloff below."""
    panel = np.empty((height, STYLE.panel, 3), np.uint8)
    panel[:] = STYLE.paper
    half = height // 2
    _draw_misfit(Canvas(panel[:half]), calibration, fit)
    panel[half - 1 : half + 1] = STYLE.background
    split = STYLE.panel * 2 // 5 if calibration.gain_map is not None else 0
    _draw_falloff(Canvas(panel[half:, split:]), calibration)
    if split:
        _draw_gain(Canvas(panel[half:, :split]), calibration)
    return panel


def _draw_misfit(canvas: Canvas, calibration: Calibration, fit: FitCheck) -> None:
    """Arrows from the centres of the lattice to the measured ones.

    Thick ones, with numbers, for nine regions of this flat; thin ones for the residuals of the calibration.
    """
    height, width = canvas.picture.shape[:2]
    distance = np.linalg.norm(fit.offset, axis=-1)
    longest = float(np.nanmax(distance)) if np.isfinite(distance).any() else 0.0
    canvas.text("Offset of the pixels from the lattice", (14, 24), STYLE.ink, 0.52)
    size = np.array(calibration.image_size)
    scale = min((width - 120) / size[0], (height - 104) / size[1])
    corner = np.array([(width - scale * size[0]) / 2, 38.0])
    canvas.rectangle(corner, corner + scale * size, STYLE.faint)
    _draw_residuals(canvas, calibration, corner, scale)
    enlarge = _enlargement(longest, 0.3 * scale * size.min() / 2)
    for position, offset in zip(fit.positions.reshape(-1, 2), fit.offset.reshape(-1, 2), strict=True):
        at = corner + scale * (position + 0.5)
        if np.isnan(offset).any():
            canvas.text("?", (round(at[0]) - 5, round(at[1]) + 6), STYLE.faint, 0.5)
            continue
        canvas.circle(at, 2, STYLE.faint, -1)
        canvas.arrow(at, at + enlarge * offset, STYLE.arrow, 2, 0.25)
        place = round(at[0]) - 14, round(at[1]) + 20
        canvas.text(f"{float(np.hypot(*offset)):.2g}", place, STYLE.ink, 0.4)
    words = f"numbers: this flat, px; arrows {enlarge:g} px here per px" if longest > 0 else "no region shows centres"
    canvas.text(words, (14, height - 12), STYLE.arrow, 0.44)


def _draw_residuals(canvas: Canvas, calibration: Calibration, corner: NDArray[np.float64], scale: float) -> None:
    """Arrows for the mean residuals in rectangles of the flat, where they are significant."""
    height = canvas.picture.shape[0]
    if calibration.residuals is None:
        words = "no residuals: single microimages of a scene do not show them"
        canvas.text(words, (14, height - 30), STYLE.faint, 0.44)
        return
    positions, mean, error = calibration.residuals.mean_over_grid(calibration.lattice)
    length = np.hypot(*mean.T)
    significant = length > STYLE.residual_significance * error
    room = 0.5 * scale * min(np.array(calibration.image_size) / DEFAULT.residual_grid)
    enlarge = _enlargement(float(length[significant].max(initial=0.0)), room)
    for position, offset, drawn in zip(positions, mean, significant, strict=True):
        at = corner + scale * (position + 0.5)
        canvas.circle(at, 1, STYLE.circle, -1)
        if drawn:
            canvas.arrow(at, at + enlarge * offset, STYLE.circle, 1, 0.3)
    share = f"{significant.mean():.0%} are above their noise"
    words = f"thin arrows: residuals of the fit, {enlarge:g} px here per px; {share}"
    canvas.text(words, (14, height - 30), STYLE.circle, 0.44)


def _enlargement(longest: float, room: float) -> float:
    """A power of ten times 1, 2 or 5 that makes the longest arrow fit the room [px]; 1 where there is none."""
    if longest <= 0:
        return 1.0
    power = 10 ** np.floor(np.log10(room / longest))
    return float(max(f for f in (power, 2 * power, 5 * power) if f * longest <= room))


def _draw_gain(canvas: Canvas, calibration: Calibration) -> None:
    """The gain map of the whole flat, and of its top left corner enlarged; unknown pixels in their own colour."""
    import cv2

    height, width = canvas.picture.shape[:2]
    canvas.text("Gain map", (14, 24), STYLE.ink, 0.52)
    gain = calibration.gain()
    rows = (height - 70 - 8) // 2
    scale = min(min(height - 70, width - 28) / gain.shape[1], rows / gain.shape[0])
    small = max(1, int(scale * gain.shape[1])), max(1, int(scale * gain.shape[0]))
    # Gaps are left out of the mean over the pixels that one pixel of the picture covers.
    known = cv2.resize(np.isfinite(gain).astype(np.float32), small, interpolation=cv2.INTER_AREA)
    light = cv2.resize(np.nan_to_num(gain), small, interpolation=cv2.INTER_AREA) / np.maximum(known, 1e-6)
    reach = max(8, int(4 * calibration.lattice.pitch))
    corner = cv2.resize(gain[:reach, :reach], (rows, rows), interpolation=cv2.INTER_NEAREST)
    for values, top in ((np.where(known > 0, light, np.nan), 34), (corner, 42 + rows)):
        grey = np.rint(255 * np.clip(np.nan_to_num(values), 0, 1)).astype(np.uint8)
        drawn = np.repeat(grey[..., None], 3, axis=2)
        drawn[np.isnan(values)] = STYLE.unknown
        canvas.picture[top : top + drawn.shape[0], 14 : 14 + drawn.shape[1]] = drawn
    defects = calibration.defects
    words = f"{len(defects.pixels)} pixels, {len(defects.lenses)} lenses defect"
    canvas.text(words, (14, height - 12), STYLE.defect, 0.4)


def _draw_falloff(canvas: Canvas, calibration: Calibration) -> None:
    """Relative illumination over the distance to the centre, and the usable radius."""
    height, width = canvas.picture.shape[:2]
    canvas.text("Light inside a microimage", (14, 24), STYLE.ink, 0.52)
    vignetting, radius = calibration.vignetting, calibration.lattice.radius
    if vignetting is None:
        canvas.text("not measured", (14, 54), STYLE.faint, 0.5)
        return
    low, high = np.array([52.0, height - 46.0]), np.array([width - 20.0, 44.0])
    radii = np.arange(len(vignetting.profile)) * vignetting.step
    end = max(float(radii[-1]), 1.05 * radius)

    def at(r: float, light: float) -> NDArray[np.float64]:
        return low + (high - low) * [r / end, light]

    for level in (0, 0.5, 1):
        canvas.line(at(0, level), at(end, level), STYLE.grid_line, 1)
        canvas.text(f"{level:g}", (16, round(at(0, level)[1]) + 5), STYLE.faint, 0.42)
    canvas.line(at(radius, 0), at(radius, 1), STYLE.circle, 1)
    place = round(at(radius, 0)[0]) - 54, round(at(0, 0)[1]) - 8
    canvas.text(f"R {radius:.1f}", place, STYLE.circle, 0.42)
    canvas.curve([at(r, p) for r, p in zip(radii, vignetting.profile, strict=True)], STYLE.cross)
    for share in (0, 0.5, 1):
        x, y = at(share * end, 0)
        canvas.text(f"{share * end:.1f}", (round(x) - 14 * (share > 0), round(y) + 18), STYLE.faint, 0.42)
    canvas.text("distance to the centre [px]", (width // 2 - 100, height - 8), STYLE.faint, 0.44)
