"""A picture that shows how a calibration fits a flat: its centre, three corners and where to look first."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..camera.calibration import Calibration
from ..camera.plotting import TYPE_COLOURS, plot_falloff, plot_gain, plot_residuals
from ..lattice.orientation import describe_orientation
from .fit_check import FitCheck, check_fit
from .places_to_check import PlaceToCheck, find_places_to_check

__all__ = ["show"]


def show(calibration: Calibration, image: ArrayLike) -> NDArray[np.uint8]:
    """Draw the centres and usable circles of a calibration over a flat: its centre, three corners, and where to look.

    Circles of lens types 0 to 3 are blue, orange, green and violet. Unlit lenses are crossed out, defect pixels
    circled. White circles were found without the lattice (Hough vote).
    Beside the five crops are the offsets of nine regions of the flat from the lattice, the residuals of the
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
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    flat = np.asarray(image)
    fit = check_fit(calibration, flat)
    places = find_places_to_check(calibration, flat)
    width, height = calibration.image_size
    # Six pitches across a crop, enlarged three to four times where that leaves at least two and a half.
    pitch = calibration.lattice.pitch
    reach = min(max(float(np.clip(6 * pitch, 140, 190)), 2.5 * pitch), width, height)
    left, top = reach / 2 - 0.5, reach / 2 - 0.5
    right, low = width - 0.5 - reach / 2, height - 0.5 - reach / 2
    crops = {
        (0, 0): ("top left", (left, top)),
        (0, 1): ("centre", ((width - 1) / 2, (height - 1) / 2)),
        (0, 2): ("top right", (right, top)),
        (1, 0): ("bottom left", (left, low)),
        (1, 2): ("bottom right", (right, low)),
    }
    if places:
        x, y = places[0].position
        crops[1, 2] = "look here", (float(np.clip(x, left, right)), float(np.clip(y, top, low)))
    figure = Figure((18, 12.9), dpi=100, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    figure.suptitle(_describe(calibration, fit), x=0.01, ha="left", fontsize=13)
    grid = figure.add_gridspec(2, 3)
    for cell, (name, middle) in crops.items():
        axes = figure.add_subplot(grid[cell])
        _draw_crop(axes, calibration, flat, np.array(middle), reach, places if name == "look here" else [])
        axes.set_title(name)
    panel = grid[1, 1].subgridspec(2, 2, height_ratios=(1.4, 1))
    _draw_misfit(figure.add_subplot(panel[0, :]), calibration, fit)
    plot_gain(calibration, figure.add_subplot(panel[1, 0]))
    plot_falloff(calibration, figure.add_subplot(panel[1, 1]))
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]


def _describe(calibration: Calibration, fit: FitCheck) -> str:
    """Two lines: the lattice; and the flat, its lens types, how well it is known and fits."""
    lattice = calibration.lattice
    shape, rows, turned = describe_orientation(lattice)
    words = f"{shape}, rows {rows}" if rows != "both ways" else shape
    residual = "" if np.isnan(calibration.residual_rms) else f", residual {calibration.residual_rms:.3f} px RMS"
    worry = "too much, calibrate on this flat" if fit.warning else f"no worry below {fit.limit:.1f}"
    known = f"off this flat by {fit.max_offset:.2f} px ({worry})"
    off = "its fit to this flat is unknown" if np.isnan(fit.max_offset) else known
    size = "{} x {} px".format(*calibration.image_size)
    types = "" if calibration.lens_types is None else f"{calibration.lens_types.count} lens types, "
    return (
        f"{words}, pitch {lattice.pitch:.4f} px, rotation {turned:+.4f} deg, usable radius {lattice.radius:.2f} px, "
        f"{len(lattice)} lenses\n"
        f"{size}, {types}from {calibration.source}{residual}, confidence {calibration.confidence:.2f}; {off}"
    )


def _draw_crop(
    axes: Any,
    calibration: Calibration,
    flat: NDArray[Any],
    middle: NDArray[np.float64],
    reach: float,
    places: list[PlaceToCheck],
) -> None:
    """Crop of the flat, `reach` [px] wide around `middle` (2,), with centres, usable circles and defects."""
    from matplotlib.collections import EllipseCollection, LineCollection

    lattice = calibration.lattice
    left, top = middle - reach / 2
    right, bottom = middle + reach / 2
    low = np.maximum(np.floor([left, top]).astype(int) - 1, 0)
    high = np.minimum(np.ceil([right, bottom]).astype(int) + 2, lattice.image_size)
    extent = low[0] - 0.5, high[0] - 0.5, high[1] - 0.5, low[1] - 0.5
    crop = _stretch_contrast(flat[low[1] : high[1], low[0] : high[0]])
    axes.imshow(crop, extent=extent, interpolation="bicubic")
    axes.set(xlim=(left, right), ylim=(bottom, top))

    def near(positions: NDArray[Any]) -> Any:
        return (np.abs(positions - middle) < reach / 2 + lattice.pitch).all(1)

    def circles(centres: NDArray[Any], radius: Any, colour: Any, width: float = 1.2) -> None:
        size = np.full(len(centres), 2 * radius)
        # A dark line below a light one is visible on any background.
        for line, edge in ((width + 1.5, (0, 0, 0, 0.4)), (width, colour)):
            axes.add_collection(
                EllipseCollection(
                    size, size, 0 * size, units="xy", offsets=centres, offset_transform=axes.transData,
                    facecolor="none", edgecolor=edge, linewidth=line,
                )
            )  # fmt: skip

    shown = near(lattice.centres())
    centres, types = lattice.centres()[shown], calibration.lens_types
    kinds = np.zeros(len(centres), int) if types is None else types.of(lattice.indices()[shown])
    for kind in np.unique(kinds):
        circles(centres[kinds == kind], lattice.radius, TYPE_COLOURS[kind % len(TYPE_COLOURS)])
    axes.plot(*centres.T, "+", color="gold", markersize=9, markeredgewidth=1.2)
    pixels = calibration.defects.pixels
    circles(pixels[near(pixels)], 1.5, "magenta")
    missing = lattice.points(calibration.defects.lenses)
    arm = lattice.radius / np.sqrt(2)
    ends = np.array([[[-arm, -arm], [arm, arm]], [[-arm, arm], [arm, -arm]]])
    axes.add_collection(LineCollection((missing[near(missing), None, None] + ends).reshape(-1, 2, 2), color="magenta"))
    for place in places:
        found = place.circles[near(place.circles[:, :2])]
        circles(found[:, :2], found[:, 2], "white")


def _draw_misfit(axes: Any, calibration: Calibration, fit: FitCheck) -> None:
    """Arrows from the centres of the lattice to those measured in nine regions of this flat, over the residuals."""
    plot_residuals(calibration, axes, alpha=0.5)
    positions, offset = fit.positions.reshape(-1, 2), fit.offset.reshape(-1, 2)
    if np.nan_to_num(offset).any():
        axes.quiver(*positions.T, *offset.T, angles="xy", color="firebrick", width=0.008)
    for place, length in zip(positions, np.hypot(*offset.T), strict=True):
        axes.annotate("?" if np.isnan(length) else f"{length:.2g}", place, fontsize=9)
    axes.set_title("Offset of this flat from the lattice [px] (red), residuals of the fit", fontsize=10)
    axes.margins(0.1)


def _stretch_contrast(crop: NDArray[Any]) -> NDArray[np.uint8]:
    """A crop of a flat as RGB (h, w, 3), its darkest and brightest percent black and white."""
    values = np.nan_to_num(crop.astype(np.float32))
    if values.ndim == 2:
        values = np.repeat(values[..., None], 3, axis=2)
    low, high = np.percentile(values, (1, 99))
    scaled = np.clip((values - low) / max(high - low, 1e-6), 0, 1)
    return np.rint(255 * scaled ** (1 / 1.4)).astype(np.uint8)
