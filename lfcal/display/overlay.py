"""A picture of a calibration over a flat: centre, corners, offsets, gain, and a place to check."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..camera.calibration import Calibration
from ..camera.plotting import draw_circles, draw_lenses, plot_falloff, plot_gain, plot_residuals
from ..hough.circle_vote import find_circles
from ..images.mosaic import equalise_mosaic, remove_mosaic
from ..images.preprocessing import sqrt_luminance
from ..lattice.lattice import describe_orientation
from ..runtime.arrays import Array, Floats, stretch_contrast
from .fit_check import FitCheck, check_fit

__all__ = ["PlaceToCheck", "find_places_to_check", "show"]


# Width of a crop [pitches].
_CROP = 6
# Line widths [points]: a dark line below a light one is visible on any background.
_LINE = 1
_SHADOW = 3
# Left end of the heading, as a share of the width: not at the border of the picture.
_LEFT = 0.01
# A lens farther than this from the lattice is worth a look [pitch]; a smaller limit also names
# lenses whose distance nobody sees on the crops.
_FAR = 0.02


class PlaceToCheck(NamedTuple):
    """A place on a flat, and the reason to look at it."""

    position: Floats  # (2,) [px]
    sentence: str
    circles: Floats  # (n, 3) x, y, radius [px] of circles that were found without the lattice


def show(calibration: Calibration, image: ArrayLike) -> NDArray[np.uint8]:
    """Draw the centres and usable circles of a calibration over five crops of a flat.

    The crops show the centre, three corners and the place that should be checked first. Circles of
    lens types 0 to 3 are blue, orange, green and violet; square microimages have squares. Unlit
    lenses are crossed out, defect pixels circled. White circles were found without the lattice
    (Hough vote). Beside the crops are the offsets of nine regions of the flat from the lattice, the
    residuals of the calibration, the gain map, and the light falloff inside a microimage.

    `image` (h, w) or (h, w, 3) is a white image or scene capture of this camera; FlatError if it is
    of another size. The picture is (h, w, 3) uint8, RGB.

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
    size = np.array(calibration.image_size)
    lattice = calibration.lattice
    reach = min(_CROP * lattice.pitch, *size)
    first = np.full(2, reach / 2 - 0.5)
    end = size - 1 - first
    shares = {"top left": (0, 0), "centre": (0.5, 0.5), "top right": (1, 0), "bottom left": (0, 1)}
    crops = {name: first + (end - first) * share for name, share in shares.items()}
    last = "bottom right"
    if places:
        last = "look here"
    crops[last] = np.clip(places[0].position, first, end) if places else end
    figure = Figure((16, 12), dpi=100, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    figure.suptitle(_describe(calibration, fit), x=_LEFT, ha="left", size="x-large")
    axes = figure.subplot_mosaic(
        [
            ["top left", "centre", "top right"],
            ["bottom left", [["misfit", "misfit"], ["gain", "falloff"]], last],
        ]
    )
    for name, middle in crops.items():
        shown = []
        if name == "look here":
            shown = places
        _draw_crop(axes[name], calibration, flat, middle, reach, shown)
        axes[name].set_title(name)
    _draw_misfit(axes["misfit"], calibration, fit)
    plot_gain(lattice, calibration.gain_map, calibration.defects, axes["gain"])
    plot_falloff(lattice.radius, calibration.vignetting, axes["falloff"])
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]


def find_places_to_check(calibration: Calibration, flat: Array) -> list[PlaceToCheck]:
    """Places on a flat (h, w) or (h, w, 3) at which the lattice may be wrong, the worst one first.

    One is the circle of a Hough vote that lies farthest from the lattice, the other one the lens
    with the largest residual.
    """
    lattice = calibration.lattice
    residuals = calibration.residuals
    places = []
    light = flat
    if calibration.mosaic is not None and flat.ndim == 2:
        # Colour filters draw edges of their own.
        light = remove_mosaic(equalise_mosaic(flat))
    circles = find_circles(sqrt_luminance(light), lattice.pitch)
    if len(circles.centres):
        nearest = lattice.points(np.rint(lattice.to_index(circles.centres)))
        beside = np.hypot(*(nearest - circles.centres).T)
        worst = circles.centres[beside.argmax()]
        off = int((beside > lattice.pitch / 4).sum())
        sentence = (
            f"{off} of {len(beside)} circles found without the lattice (white) lie more than a "
            f"quarter of the pitch beside it, the farthest at x {worst[0]:.0f}, y {worst[1]:.0f}: "
            "see whether they are microimages or scene"
        )
        found = np.column_stack([circles.centres, circles.radii])
        if off:
            places.append(PlaceToCheck(worst, sentence, found))
    beside = np.zeros(1)
    if residuals is not None and len(residuals.offset):
        beside = np.hypot(*residuals.offset.T)
    if residuals is not None and beside.max() > _FAR * lattice.pitch:
        i, j = index = residuals.indices[beside.argmax()]
        place = lattice.points(index[None])[0]
        sentence = (
            f"lens {i}, {j} at x {place[0]:.0f}, y {place[1]:.0f} lies farthest from the lattice: "
            f"{beside.max():.2f} px; half of them lie within {np.median(beside):.2g} px"
        )
        places.append(PlaceToCheck(place, sentence, np.zeros((0, 3))))
    return places


def _describe(calibration: Calibration, fit: FitCheck) -> str:
    """Two lines: the lattice; and the flat, its lens types, its uncertainty and its fit."""
    lattice = calibration.lattice
    shape, rows, turned = describe_orientation(lattice)
    residual = ""
    if not np.isnan(calibration.residual_rms):
        residual = f", residual {calibration.residual_rms:.3f} px RMS"
    worry = f"no worry below {fit.limit:.1f}"
    if fit.warning:
        worry = "too much, calibrate on this flat"
    off = "its fit to this flat is unknown"
    if not np.isnan(fit.max_offset):
        off = f"off this flat by {fit.max_offset:.2f} px ({worry})"
    types = calibration.lens_types
    kinds = "" if types is None else f"{types.count} lens types, "
    width, height = calibration.image_size
    return (
        f"{shape}, rows {rows}, pitch {lattice.pitch:.4f} px, rotation {turned:+z.4f} degrees, "
        f"usable radius {lattice.radius:.2f} px, {len(lattice)} lenses\n"
        f"{width} x {height} px, {kinds}from {calibration.source}{residual}, "
        f"confidence {calibration.confidence_text}; {off}"
    )


def _draw_crop(
    axes: Any,
    calibration: Calibration,
    flat: Array,
    middle: Array,
    reach: float,
    places: list[PlaceToCheck],
) -> None:
    """Draw a crop of the flat, `reach` [px] wide about `middle` (2,), with lenses and defects."""
    from matplotlib.patheffects import withStroke

    (left, top), (right, bottom) = middle - reach / 2, middle + reach / 2
    x0 = max(int(left) - 1, 0)
    y0 = max(int(top) - 1, 0)
    crop = stretch_contrast(flat[y0 : int(bottom) + 2, x0 : int(right) + 2])
    extent = x0 - 0.5, x0 + crop.shape[1] - 0.5, y0 + crop.shape[0] - 0.5, y0 - 0.5
    axes.imshow(crop, extent=extent, interpolation="bicubic", cmap="gray")
    axes.set(xlim=(left, right), ylim=(bottom, top))

    lattice = calibration.lattice

    def near(positions: Array) -> Any:
        return (np.abs(positions - middle) < reach / 2 + lattice.pitch).all(1)

    shadow = withStroke(linewidth=_SHADOW, foreground=(0, 0, 0, 0.5))
    style = {"linewidth": _LINE, "path_effects": [shadow]}
    centres = lattice.centres()
    pixels = calibration.defects.pixels
    missing = lattice.points(calibration.defects.lenses)
    draw_lenses(
        lattice, calibration.lens_types, axes, near(centres), calibration.lit_reach(), **style
    )
    axes.plot(*centres[near(centres)].T, "+", color="gold", markersize=10, markeredgewidth=_LINE)
    draw_circles(axes, pixels[near(pixels)], 1.5, "magenta", **style)
    axes.plot(*missing[near(missing)].T, "x", color="magenta", markersize=32, markeredgewidth=2)
    for place in places:
        found = place.circles[near(place.circles[:, :2])]
        draw_circles(axes, found[:, :2], found[:, 2], "white", **style)


def _draw_misfit(axes: Any, calibration: Calibration, fit: FitCheck) -> None:
    """Draw the offsets of nine regions of this flat from the lattice, over the residuals."""
    plot_residuals(calibration.lattice, calibration.residuals, axes, alpha=0.5)
    positions = fit.positions.reshape(-1, 2)
    offset = fit.offset.reshape(-1, 2)
    if np.nan_to_num(offset).any():
        axes.quiver(*positions.T, *offset.T, angles="xy", color="firebrick")
    # Figures stand inside the frame.
    across, down = np.meshgrid(("left", "center", "right"), ("top", "center", "bottom"))
    figures = zip(positions, np.hypot(*offset.T), across.flat, down.flat, strict=True)
    for place, length, ha, va in figures:
        axes.annotate("?" if np.isnan(length) else f"{length:.2g}", place, ha=ha, va=va)
    axes.set_title("Offset of this flat from the lattice [px] (red), residuals of the fit", size=10)
    # The corners need room for their figures.
    axes.margins(0.1)
