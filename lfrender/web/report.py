"""The report of a flat: calibration, depth and pictures on one HTML page that needs no network."""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration
from lfcal.runtime.output_file import atomic_write
from lfcal.runtime.page import to_svg

from ..data.depth_map import (
    BINOCULAR,
    MODE_COLOURS,
    MODES,
    REASONS,
    TELESCOPIC,
    DepthMap,
    finite,
    magnification_range,
)
from ..data.depth_order import depth_limits, name_ends
from ..data.rendering import PictureGrid
from ..output.depth_picture import lens_maps
from ..output.finish import Finish, flat_picture
from .calibration_figure import calibration_panels, flat_part
from .report_pictures import ReportPictures, data_urls, draw_pictures, picture_url, reduce_picture
from .templates import Markup, fill, read_asset

__all__ = ["write_report"]

# Ends of the scale of M of a depth map without depth.
_LIMITS_OF_NONE = (1.0, 10.0)
# Number of bars of the histogram, and its size [inch]: a phone shows it at this width, with text
# that can be read.
_BINS = 40
_CHART = (4.4, 2.4)
# Largest width of the maps and of the flat [px], twice that of their column on the page; largest
# number of pixels per pitch of the maps: each lens has one colour.
_WIDTH = 1120
_MAP_SCALE = 12.0
# Characters for the pictures of a page: mail programs and browsers accept pages of 15 MB.
_ROOM = 14_500_000
# Side of the crop of the flat, and of the window in which detail is looked for [pitches].
_CROP = 7
_SOURCES = {
    "white": "a white image",
    "scene": "the capture itself",
    "published": "a published calibration",
    "truth": "the simulation",
}


def write_report(
    path: str | os.PathLike[str],
    flat: NDArray,
    calibration: Calibration,
    depth: DepthMap,
    pictures: ReportPictures | None = None,
    *,
    title: str = "Light field",
    seconds: Mapping[str, float] | None = None,
    compare: Mapping[str, NDArray] | None = None,
    further: Any = "",
    command: str = "lfrender report",
) -> None:
    """Write the report of a flat as one HTML file of at most 15 MB that opens offline.

    `pictures` are drawn if they are not given. `seconds` holds the time of each stage, `compare`
    other pictures by their names, on the grid of the all-in-focus picture, and `further` more
    sections as HTML (`markupsafe.Markup`). The footer names the `command`. OutputError if the page
    cannot be written; FlatError and CalibrationError as for `render`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> with TemporaryDirectory() as folder:
    ...     write_report(f"{folder}/report.html", *lfrender.data.example())
    ...     Path(folder, "report.html").read_text()[:15]
    '<!doctype html>'
    """
    pictures = pictures or draw_pictures(flat, calibration, depth)
    lattice = calibration.lattice
    scale = min(_MAP_SCALE, _WIDTH * lattice.pitch / flat.shape[1])
    grid = PictureGrid(lattice.image_size, lattice.pitch, scale)
    maps = lens_maps(depth, lattice, grid.affine(), grid.size[::-1])
    charts = {name: picture_url(picture, ".png") for name, picture in maps.items()}
    raw = Finish("flat.webp").apply(flat_picture(flat, calibration)).image
    finish = Finish("picture.webp").measured(pictures.sharp)
    drawn = {"all_in_focus": pictures.sharp, "traditional": pictures.traditional, **pictures.fixed}
    drawn |= {name: flat_picture(pixels, calibration) for name, pixels in (compare or {}).items()}
    shown = {name: finish.apply(picture).image for name, picture in drawn.items()}
    shown["flat"] = reduce_picture(raw, min(1.0, _WIDTH / flat.shape[1]))
    panels = calibration_panels(flat, calibration)
    crop = flat_part(flat, _most_detail(pictures), _CROP * calibration.lattice.pitch)
    room = _ROOM - sum(map(len, [*charts.values(), further, panels, crop["url"]]))
    urls, size = data_urls(shown, room)
    height, width = pictures.sharp.image.shape[:2]
    known = finite(depth.magnification)
    low, high = magnification_range(known) if known.size else _LIMITS_OF_NONE
    reasons = {
        REASONS[code]: float(np.mean(depth.reason == code))
        for code in np.unique(depth.reason)
        if code
    }
    page = fill(
        "report.html",
        style=read_asset("report.css"),
        script=read_asset("report.js"),
        title=title,
        command=command,
        version=version("lfrender"),
        calibration=calibration,
        source=_SOURCES.get(calibration.source, calibration.source),
        known=float(np.mean(~depth.filled)),
        width=width,
        height=height,
        size=size,
        names=list(drawn),
        urls=urls,
        sizes=pictures.patch_size,
        charts=charts,
        ends=name_ends(depth_limits(depth)),
        histogram=_histogram(depth, low, high),
        outliers=int(np.sum((known < low) | (known > high))),
        panels=panels,
        crop=crop,
        further=further,
        modes=[
            (name, MODE_COLOURS[code], float(np.mean(depth.mode == code)))
            for code, name in MODES.items()
        ],
        reasons=dict(sorted(reasons.items(), key=lambda item: -item[1])),
        seconds=seconds or {},
        cards=_figures(calibration, depth, pictures, seconds or {}),
        turned=float(np.degrees(np.arctan2(*calibration.lattice.basis[0, ::-1]))),
    )
    with atomic_write(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _most_detail(pictures: ReportPictures) -> NDArray[np.float64]:
    """Place on the flat [px] around which lenses differ most and no lens is dark."""
    import cv2

    image = np.atleast_3d(pictures.traditional.image).astype(np.float32)[..., :3].mean(2)
    window = (_CROP, _CROP)  # the traditional picture has a pixel per pitch
    spread = cv2.blur(image**2, window) - cv2.blur(image, window) ** 2
    # Lenses beyond the border count as dark.
    darkest = cv2.erode(image, np.ones(window), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    v, u = np.unravel_index(int((np.sqrt(np.maximum(spread, 0)) * darkest).argmax()), image.shape)
    place: NDArray[np.float64] = pictures.traditional.affine @ [u, v, 1]
    return place


def _histogram(depth: DepthMap, low: float, high: float) -> Any:
    """SVG: number of lenses over magnification, telescopic ones above the axis, binocular below.

    Heights are square roots of the numbers, so that single branches can be seen beside a wall with
    thousands of lenses of one M. 98 % of the lenses lie between `low` and `high`. Pale bars at the
    ends are lenses beyond the scale, mostly errors.
    """
    from matplotlib.figure import Figure

    step = (high / low) ** (1 / _BINS)
    edges = np.geomspace(low / step, high * step, _BINS + 3)
    figure = Figure(_CHART, facecolor="none", layout="constrained")
    axes = figure.subplots()
    for code in (TELESCOPIC, BINOCULAR):
        found = np.clip(depth.magnification[depth.mode == code], edges[0], edges[-1])
        heights = code * np.sqrt(np.histogram(found, edges)[0])
        colour = np.array(MODE_COLOURS[code]) / 255
        bars = axes.bar(edges[:-1], heights, 0.95 * np.diff(edges), align="edge", color=colour)
        for beyond in (bars[0], bars[-1]):
            beyond.set_alpha(0.45)
    axes.axhline(0, color="0.5", linewidth=1)
    axes.set(xscale="log", xlim=edges[[0, -1]], facecolor="none")
    # Grey can be read on dark and on light pages.
    axes.tick_params(which="both", colors="0.5")
    axes.spines[:].set_visible(False)
    axes.set_xticks(np.geomspace(low, high, 6))
    axes.minorticks_off()
    axes.xaxis.set_major_formatter("{x:.3g}")
    axes.yaxis.set_major_formatter(lambda height, _: f"{height**2:.0f}")
    return Markup(to_svg(figure))


def _figures(
    calibration: Calibration,
    depth: DepthMap,
    pictures: ReportPictures,
    seconds: Mapping[str, float],
) -> dict[str, str]:
    """Names and figures of the cards at the top."""
    known = finite(depth.magnification)
    figures = {
        "lenses with a depth": f"{np.mean(~depth.filled):.1%}",
        "telescopic": f"{np.mean(depth.mode == 1):.1%}",
        "binocular": f"{np.mean(depth.mode == -1):.1%}",
        "magnification M, median": f"{np.median(known):.2f}" if known.size else "unknown",
        "calibration confidence": calibration.confidence_text,
        "pixels per microlens pitch": f"{pictures.sharp.scale:.1f}",
    }
    if calibration.optics is not None:
        seen = finite(depth.distance(calibration))
        sure = finite(depth.distance_error(calibration))
        if seen.size and sure.size:
            figures["distance, median"] = (
                f"{np.median(seen):.3g} m, each to {np.median(sure):.2g} m"
            )
    if seconds:
        figures["time"] = f"{sum(seconds.values()):.1f} s"
    return figures
