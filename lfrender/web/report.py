"""The report of a flat: calibration, depth and pictures on one HTML page that needs no network."""

from __future__ import annotations

import os
from collections.abc import Mapping
from html import escape
from importlib.metadata import version
from importlib.resources import files
from string import Template

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration
from lfcal.runtime.output_file import atomic_write

from ..data.depth_map import REASONS, DepthMap
from ..output.depth_picture import MODE_COLOURS, MODES, magnification_limits
from .calibration_figure import calibration_panels, enlarged_crop
from .report_figures import (
    ReportPictures,
    bars,
    cards,
    data_urls,
    draw_pictures,
    fit_width,
    magnification_histogram,
    maps,
    outliers,
    png_url,
    table,
)

__all__ = ["write_report"]

_SHORTCUTS = {
    "blank": "lenses without texture, which were not matched",
    "ranges": "shifts that occur in no lens of a sample, which were not tried",
    "still": "lenses that have not changed since the frame before",
    "roi": "lenses outside the chosen part",
}
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
    further: str = "",
    command: str = "lfrender report",
    largest: int = 14_500_000,
) -> None:
    """Write the report of a flat as one HTML file of at most 15 MB that opens offline.

    Parameters
    ----------
    path : path-like
    flat : (H, W) or (H, W, C) array
    calibration : Calibration
    depth : DepthMap
        Of this flat.
    pictures : ReportPictures, optional
        Drawn if not given.
    title : str
    seconds : mapping of str to float, optional
        Time per stage.
    compare : mapping of str to array, optional
        Further pictures to compare with, by their names, on the grid of the all-in-focus one.
    further : str
        Sections to add, as HTML.
    command : str
        The command that made the page, for its footer.
    largest : int
        Most characters of pictures and maps; mail programs and browsers accept pages of 15 MB.

    Raises
    ------
    OutputError
        If the file cannot be written.
    FlatError, CalibrationError
        As `render`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> import lfrender
    >>> sample = lfrender.data.house(size=(240, 180), samples=2)
    >>> flat, camera = sample.flat, sample.truth.calibration
    >>> depth = lfrender.analyze(flat, camera, "fast")
    >>> with TemporaryDirectory() as folder:
    ...     write_report(f"{folder}/report.html", flat, camera, depth)
    ...     Path(folder, "report.html").read_text()[:15]
    '<!doctype html>'
    """
    pictures = draw_pictures(flat, calibration, depth) if pictures is None else pictures
    charts = {name: png_url(picture) for name, picture in maps(depth, calibration.lattice).items()}
    shown = {
        "all_in_focus": pictures.sharp.image,
        **{name: picture.image for name, picture in pictures.fixed.items()},
        "traditional": pictures.traditional.image,
        **(compare or {}),
        "flat": fit_width(flat, 1120, calibration.white_level),
    }
    panels = calibration_panels(flat, calibration)
    crop = enlarged_crop(flat, _most_detail(pictures), 7 * calibration.lattice.pitch)
    room = largest - sum(map(len, charts.values())) - len(further) - len(panels) - len(crop)
    urls, size = data_urls(shown, room, calibration.white_level)
    web = files(__package__) / "assets"
    limits = magnification_limits(depth.magnification)
    names = {"all_in_focus": "all in focus", "traditional": "traditional"}
    names |= {name: f"one patch size, {name}" for name in pictures.fixed} | {name: name for name in compare or {}}
    height, width = pictures.sharp.image.shape[:2]
    page = Template((web / "report.html").read_text(encoding="utf-8")).substitute(
        charts,
        title=escape(title),
        style=(web / "report.css").read_text(encoding="utf-8"),
        script=(web / "report.js").read_text(encoding="utf-8"),
        summary=_summary(calibration, depth, pictures),
        warnings=_warnings(calibration, depth, size),
        cards=_figures(calibration, depth, pictures, seconds or {}),
        sources="".join(_source(name, words, urls[name]) for name, words in names.items()),
        choices=_choices(pictures, names),
        width=round(size * width),
        height=round(size * height),
        histogram=magnification_histogram(depth),
        low=f"{limits[0]:.2f}",
        high=f"{limits[1]:.2f}",
        modes_legend=_modes_legend(depth),
        reasons=_reasons(depth),
        outliers=outliers(depth),
        flat=urls["flat"],
        crop=crop,
        lenses=f"{len(calibration.lattice):,}",
        pitch=f"{calibration.lattice.pitch:.1f}",
        panels=panels,
        camera=_camera(calibration),
        saved=_saved(depth),
        times=bars(dict(seconds)) if seconds else "<p>Not measured.</p>",
        further=further,
        command=escape(command),
        version=version("lfrender"),
    )
    with atomic_write(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _summary(calibration: Calibration, depth: DepthMap, pictures: ReportPictures) -> str:
    width, height = calibration.image_size
    lattice = calibration.lattice
    drawn = "{1} &times; {0}".format(*pictures.sharp.image.shape[:2])
    return (
        f"{width} &times; {height} px behind {len(lattice):,} microlenses of {lattice.pitch:.2f} px pitch, "
        f"calibrated from {_SOURCES.get(calibration.source, escape(calibration.source))}. "
        f"{np.mean(~depth.filled):.0%} of the lenses have a depth; the picture has {drawn} px."
    )


def _warnings(calibration: Calibration, depth: DepthMap, size: float) -> str:
    warnings = list(calibration.warnings)
    if calibration.confidence < 0.5:
        warnings.append(
            f"The calibration is doubtful (confidence {calibration.confidence:.2f}): worry if circles lie beside the "
            "microimages below, and calibrate on a white image then."
        )
    missing = float(np.mean(depth.filled))
    if missing > 0.5:
        warnings.append(
            f"{missing:.0%} of the lenses have no depth of their own. They are drawn with that of neighbours, which "
            "is no harm where the scene has no texture; worry where it has."
        )
    if size < 1:
        warnings.append(
            f"The pictures on this page are reduced to {size:.0%} of their width and height; 'lfrender render' "
            "writes them whole."
        )
    if not warnings:
        return ""
    return (
        '<section class="warnings" aria-label="Warnings"><h2>Warnings</h2><ul>'
        + "".join(f"<li>{escape(text[:1].upper() + text[1:])}</li>" for text in warnings)
        + "</ul></section>"
    )


def _most_detail(pictures: ReportPictures) -> NDArray[np.float64]:
    """The place of the flat [px] about which lenses differ most, and none is dark."""
    import cv2

    image = pictures.traditional.image.astype(np.float32)
    image = image if image.ndim == 2 else np.ascontiguousarray(image[..., :3].mean(2))
    spread = cv2.blur(image**2, (7, 7)) - cv2.blur(image, (7, 7)) ** 2
    score = np.sqrt(np.maximum(spread, 0)) * cv2.erode(image, np.ones((7, 7)))
    inner = tuple(slice(3, -3) if n > 6 else slice(None) for n in score.shape)
    v, u = np.array(np.unravel_index(int(score[inner].argmax()), score[inner].shape)) + [s.start or 0 for s in inner]
    place: NDArray[np.float64] = pictures.traditional.affine @ [u, v, 1]
    return place


def _figures(calibration: Calibration, depth: DepthMap, pictures: ReportPictures, seconds: Mapping[str, float]) -> str:
    known = depth.magnification[np.isfinite(depth.magnification)]
    figures = {
        "lenses with a depth": f"{np.mean(~depth.filled):.1%}",
        "telescopic": f"{np.mean(depth.mode == 1):.1%}",
        "binocular": f"{np.mean(depth.mode == -1):.1%}",
        "magnification M, median": f"{np.median(known):.2f}" if known.size else "unknown",
        "calibration confidence": f"{calibration.confidence:.2f}",
        "pixels per microlens pitch": f"{pictures.sharp.scale:.1f}",
    }
    if calibration.optics is not None:
        away = depth.distance(calibration)
        errors = depth.distance_error(calibration)
        seen, sure = away[np.isfinite(away)], errors[np.isfinite(errors)]
        if seen.size and sure.size:
            figures["distance, median"] = f"{np.median(seen):.3g} m, each to {np.median(sure):.2g} m"
    if seconds:
        figures["time"] = f"{sum(seconds.values()):.1f} s"
    return cards(figures)


def _choices(pictures: ReportPictures, names: Mapping[str, str]) -> str:
    # What the same flat shows without depth comes first.
    order = ["traditional", *(name for name in names if name not in ("traditional", "all_in_focus"))]
    sizes = {name: f" ({size:+.2f} px)" for name, size in pictures.patch_size.items()}
    return "".join(
        f'<button type="button" data-choice="{name}" aria-pressed="{"true" if n == 0 else "false"}">'
        f"{escape(names[name] + sizes.get(name, ''))}</button>"
        for n, name in enumerate(order)
    )


def _source(name: str, words: str, url: str) -> str:
    return f'<img data-name="{name}" data-words="{escape(words)}" alt="{escape(words)}" hidden src="{url}">'


def _modes_legend(depth: DepthMap) -> str:
    return "".join(
        f'<span><i style="background:rgb{MODE_COLOURS[code]}"></i>{name} {np.mean(depth.mode == code):.1%}</span>'
        for code, name in MODES.items()
    )


def _reasons(depth: DepthMap) -> str:
    found = {REASONS[code]: float(np.mean(depth.reason == code)) for code in np.unique(depth.reason) if code}
    if not found:
        return "<p>Every lens has a depth of its own.</p>"
    return bars(dict(sorted(found.items(), key=lambda item: -item[1])), "{:.2%} of the lenses")


def _camera(calibration: Calibration) -> str:
    lattice = calibration.lattice
    turned = float(np.degrees(np.arctan2(lattice.basis[0, 1], lattice.basis[0, 0])))
    facts = [
        ("Measured on", _SOURCES.get(calibration.source, calibration.source)),
        ("Neighbours of a lens", "six (hexagonal)" if len(lattice.steps) == 6 else "four"),
        ("Pitch", f"{lattice.pitch:.4f} px"),
        ("First lattice vector", f"{turned:+.3f} degrees from the rows"),
        ("Usable radius", f"{lattice.radius:.2f} px"),
        ("Distortion", "none found" if lattice.distortion is None else "corrected"),
        ("Lens types", "one" if calibration.lens_types is None else str(calibration.lens_types.count)),
        ("Confidence", f"{calibration.confidence:.2f}"),
    ]
    if not np.isnan(calibration.residual_rms):
        facts.insert(5, ("Residual of single lenses", f"{calibration.residual_rms:.4f} px RMS"))
    if calibration.mosaic:
        facts.append(("Colour mosaic", calibration.mosaic))
    return table(facts)


def _saved(depth: DepthMap) -> str:
    if not depth.saved:
        return "<p>Nothing was skipped: every lens was matched at every shift.</p>"
    return bars({_SHORTCUTS.get(name, name): share for name, share in depth.saved.items()}, "{:.1%} of the work")
