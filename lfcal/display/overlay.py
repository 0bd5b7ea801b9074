"""A picture that shows how a calibration fits a flat: its centre, three corners and where to look first."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..camera.calibration import Calibration
from ..lattice.orientation import describe_orientation
from .drawing import Canvas
from .fit_check import FitCheck, check_fit
from .panels import draw_figures
from .places_to_check import PlaceToCheck, find_places_to_check
from .settings import STYLE

__all__ = ["show"]


def show(calibration: Calibration, image: ArrayLike) -> NDArray[np.uint8]:
    """Draw the centres and usable circles of a calibration over a flat: its centre, three corners, and where to look.

    Circles of lens types 0 to 3 are blue, pink, green and yellow. Unlit lenses are crossed out, defect pixels circled.
    White circles were found without the lattice (Hough vote).
    Beside the five crops a panel shows the offsets of nine regions of the flat from the lattice, the residuals of the
    calibration, the gain map, and the light falloff inside a microimage.

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

    Examples
    --------
    >>> import lfcal, lfrender
    >>> sample = lfrender.data.house(size=(240, 180), samples=2)
    >>> lfcal.show(sample.truth.calibration, sample.white).dtype
    dtype('uint8')
    """
    flat = np.asarray(image)
    fit = check_fit(calibration, flat)
    width, height = calibration.image_size
    pitch, panel = calibration.lattice.pitch, STYLE.panel
    zoom = float(np.clip(panel / (STYLE.pitches * pitch), STYLE.least_zoom, STYLE.most_zoom))
    zoom = min(zoom, panel / (STYLE.least_pitches * pitch))
    reach = min(panel / zoom, width, height)
    left, top = reach / 2 - 0.5, reach / 2 - 0.5
    right, low = width - 0.5 - reach / 2, height - 0.5 - reach / 2
    crops = {
        (0, 0): ("top left", (left, top)),
        (0, 1): ("centre", ((width - 1) / 2, (height - 1) / 2)),
        (0, 2): ("top right", (right, top)),
        (1, 0): ("bottom left", (left, low)),
        (1, 2): ("bottom right", (right, low)),
    }
    places = find_places_to_check(calibration, flat)
    if places:
        x, y = places[0].position
        crops[1, 2] = "look here", (float(np.clip(x, left, right)), float(np.clip(y, top, low)))
    side = panel + STYLE.caption
    rows = STYLE.header + 2 * (side + STYLE.space) + STYLE.space
    picture = np.empty((rows, 3 * (panel + STYLE.space) + STYLE.space, 3), np.uint8)
    picture[:] = STYLE.background
    canvas = Canvas(picture)
    first, second = _describe(calibration, fit)
    canvas.text(first, (STYLE.margin, 34), STYLE.ink, 0.75)
    canvas.text(second, (STYLE.margin, 64), STYLE.faint, 0.6)

    def corner(row: int, column: int) -> tuple[int, int]:
        return STYLE.space + column * (panel + STYLE.space), STYLE.header + row * (side + STYLE.space)

    for (row, column), (name, centre) in crops.items():
        x, y = corner(row, column)
        picture[y : y + panel, x : x + panel] = _draw_crop(
            calibration, flat, np.array(centre), panel / reach, places if name == "look here" else []
        )
        start = f"x {centre[0] - reach / 2 + 0.5:.0f}, y {centre[1] - reach / 2 + 0.5:.0f}"
        words = f"{name}, {panel / reach:.2g} times, from {start}"
        canvas.text(words, (x + 2, y + panel + 19), STYLE.faint, 0.5)
    x, y = corner(1, 1)
    picture[y : y + side, x : x + panel] = draw_figures(calibration, fit, side)
    return picture


def _describe(calibration: Calibration, fit: FitCheck) -> tuple[str, str]:
    """Two lines: the lattice; and the flat, its lens types, how well it is known and fits."""
    lattice = calibration.lattice
    shape, rows, turned = describe_orientation(lattice)
    words = f"{shape}, rows {rows}" if rows != "both ways" else shape
    first = (
        f"{words}, pitch {lattice.pitch:.4f} px, rotation {turned:+.4f} deg, usable radius {lattice.radius:.2f} px, "
        f"{len(lattice)} lenses"
    )
    residual = "" if np.isnan(calibration.residual_rms) else f", residual {calibration.residual_rms:.3f} px RMS"
    unknown = np.isnan(fit.max_offset)
    worry = "too much, calibrate on this flat" if fit.warning else f"no worry below {fit.limit:.1f}"
    off = "its fit to this flat is unknown" if unknown else f"off this flat by {fit.max_offset:.2f} px ({worry})"
    size = "{} x {} px".format(*calibration.image_size)
    types = "" if calibration.lens_types is None else f"{calibration.lens_types.count} lens types, "
    second = f"{size}, {types}from {calibration.source}{residual}, confidence {calibration.confidence:.2f}; {off}"
    return first, second


def _draw_crop(
    calibration: Calibration, flat: NDArray[Any], middle: NDArray[np.float64], zoom: float, places: list[PlaceToCheck]
) -> NDArray[np.uint8]:
    """Enlarged crop of the flat around `middle` (2,) [px] with centres, usable circles and defects."""
    import cv2

    lattice, side = calibration.lattice, STYLE.panel
    reach = side / zoom
    start = np.maximum(np.floor(middle - reach / 2).astype(int) - 2, 0)
    stop = np.minimum(np.ceil(middle + reach / 2).astype(int) + 3, lattice.image_size)
    crop = _stretch_contrast(flat[start[1] : stop[1], start[0] : stop[0]])
    # A flat position p lies at zoom * (p - middle) from the middle of the panel.
    half = (side - 1) / 2
    shift = half - zoom * (middle - start)
    matrix = np.array([[zoom, 0, shift[0]], [0, zoom, shift[1]]])
    panel: Any = cv2.warpAffine(crop, matrix, (side, side), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)

    def visible(positions: NDArray[Any], margin: float) -> Any:
        return (np.abs(positions - middle) < reach / 2 + margin).all(1)

    def on_panel(positions: NDArray[Any]) -> NDArray[np.float64]:
        return half + zoom * (positions - middle)

    centres, missing = lattice.centres(), lattice.points(calibration.defects.lenses)
    near = visible(centres, lattice.pitch)
    types = calibration.lens_types
    kinds = np.zeros(near.sum(), int) if types is None else types.of(lattice.indices()[near]) % len(STYLE.types)
    pixels = calibration.defects.pixels
    radius = zoom * lattice.radius
    arm = float(np.clip(0.12 * radius, 4, 9))
    diagonal = np.array([radius, radius]) / np.sqrt(2)
    # A dark line below a light one is visible on any background; blending leaves the pixels visible.
    for thickness, share, dark in ((3, 0.45, True), (1, 0.95, False)):
        layer = Canvas(panel.copy())
        defect, cross = ((0, 0, 0), (0, 0, 0)) if dark else (STYLE.defect, STYLE.cross)
        for at in on_panel(pixels[visible(pixels, 0)]):
            layer.circle(at, 0.8 * zoom + 2, defect, thickness)
        for at in on_panel(missing[visible(missing, lattice.pitch)]):
            for step in (diagonal, diagonal * [1, -1]):
                layer.line(at - step, at + step, defect, thickness + 1)
        for place in places:
            circles = place.circles[visible(place.circles[:, :2], lattice.pitch)]
            for at, size in zip(on_panel(circles[:, :2]), circles[:, 2], strict=True):
                layer.circle(at, zoom * size, (0, 0, 0) if dark else (255, 255, 255), thickness)
        for at, kind in zip(on_panel(centres[near]), kinds, strict=True):
            layer.circle(at, radius, (0, 0, 0) if dark else STYLE.types[kind], thickness)
            for step in (np.array([arm, 0]), np.array([0, arm])):
                layer.line(at - step, at + step, cross, thickness)
        panel = cv2.addWeighted(layer.picture, share, panel, 1 - share, 0)
    return panel


def _stretch_contrast(crop: NDArray[Any]) -> NDArray[np.uint8]:
    """A crop of a flat as RGB (h, w, 3), its darkest and brightest percent black and white."""
    values = np.nan_to_num(crop.astype(np.float32))
    if values.ndim == 2:
        values = np.repeat(values[..., None], 3, axis=2)
    low, high = np.percentile(values, (1, 99))
    scaled = np.clip((values - low) / max(high - low, 1e-6), 0, 1)
    return np.rint(255 * scaled ** (1 / 1.4)).astype(np.uint8)
