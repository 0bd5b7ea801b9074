"""An assessment as one HTML page: a verdict and a drawing of each finding."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..camera.plotting import TYPE_COLOURS, draw_circles
from ..gain.gain_map import nearest_half
from ..runtime.arrays import ENOUGH_LENSES, evenly
from ..runtime.output_file import check_output
from ..runtime.page import to_svg, write_page

if TYPE_CHECKING:
    from .result import Assessment

__all__ = ["write_assessment"]

# [inch] Size of a drawing: the page shows two side by side, with text as large as its own.
_SIZE = (4.4, 3.0)
# Angle to which smaller ones are enlarged, if a factor of 100 suffices [degrees].
_DRAWN_ANGLE = 10
# Area of the mark of a tile [points^2].
_TILE = 100
# Range of an axis over that of its data.
_MARGIN = 1.1
# What the figure of a finding is, as its heading says; the names of others say it.
_MEANINGS = {
    "distance": "rims blurred over",
    "apertures": "gaps of",
    "vignetting": "cut in the corners by",
    "exposure": "bright pixels have",
    "evenness": "one side brighter by",
    "scene, place": "moved by",
    "scene, exposure": "bright pixels have",
}


def write_assessment(path: str | os.PathLike[str], found: Assessment, title: str) -> None:
    """See `Assessment.write_page`."""
    check_output(path, {".html", ".htm"})
    findings = []
    blur = found.calibration.lens_blur
    for name, finding in found.grouped():
        drawing = ""
        # A flat without dirt is an empty frame.
        if name in _DRAWINGS and finding.measured and (name != "dirt" or finding.value > 0):
            drawing = _draw(_DRAWINGS[name], found)
        # One depth alone, that of the rims, is what the heading says.
        if name == "distance" and blur is not None and len(blur.ratios) > 1:
            drawing += _draw(_draw_blur, found)
        findings.append((name, finding, drawing))
    write_page(
        path,
        Path(__file__).with_name("assets") / "assessment.html",
        title=title,
        camera=found.calibration,
        findings=findings,
        meanings=_MEANINGS,
    )


def _draw(draw: Callable[[Any, Assessment], None], found: Assessment) -> str:
    from matplotlib.figure import Figure

    figure = Figure(_SIZE, layout="constrained")
    draw(figure.subplots(), found)
    return to_svg(figure)


def _draw_rotation(axes: Any, found: Assessment) -> None:
    """Rows of the sensor (dashed) and of lenses, with their angle enlarged."""
    value = found.rotation.value
    times = int(np.clip(_DRAWN_ANGLE / max(abs(value), 1e-6), 1, 100))
    angle = np.radians(value * times)
    along = np.linspace(-1, 1, 12)
    for offset in (-0.5, 0.0, 0.5):
        x = along * np.cos(angle) - offset * np.sin(angle)
        y = along * np.sin(angle) + offset * np.cos(angle)
        axes.axhline(offset, color="gray", linestyle="--", linewidth=1)
        axes.plot(x, y, "o-", color=TYPE_COLOURS[0], markersize=6, markerfacecolor="none")
    axes.set(
        aspect="equal", xticks=[], yticks=[], ylim=(1, -1), title=f"rows of lenses, angle x {times}"
    )


def _draw_tilt(axes: Any, found: Assessment) -> None:
    field = found.microimages
    middle = np.array(found.calibration.image_size) / 2
    half = float(np.hypot(*middle))
    slope = field.radius.slope
    _map(
        axes,
        found,
        field.place * half + middle,
        field.radii.mean(1),
        "radius of the microimages [px]",
        _TILE,
    )
    if found.tilt.is_seen:
        way = slope / max(float(np.hypot(*slope)), 1e-12) * half / 3
        axes.annotate(
            "", middle + way, middle - way, arrowprops={"arrowstyle": "->", "color": "firebrick"}
        )


def _draw_distance(axes: Any, found: Assessment) -> None:
    far, light, model = found.microimages.profile
    axes.plot(far, light, ".", color=TYPE_COLOURS[0], markersize=3, label="measured")
    axes.plot(far, model, ".", color=TYPE_COLOURS[1], markersize=1.5, label="blurred discs")
    axes.legend(loc="lower left")
    axes.set(
        xlabel="distance from the centre [px]", ylim=(0, None), title="light in the mean microimage"
    )


def _draw_blur(axes: Any, found: Assessment) -> None:
    """Measured discs of each lens type, and the line between them where the aperture is known."""
    blur = found.calibration.lens_blur
    assert blur is not None
    reach = max(0.5, _MARGIN * float(np.abs(blur.ratios).max()))
    ratios = np.linspace(-reach, reach, 100)
    discs, errors = blur.at(ratios)
    for kind, measured in enumerate(blur.discs):
        colour = TYPE_COLOURS[kind % len(TYPE_COLOURS)]
        own = blur.disc_errors[kind]
        axes.errorbar(blur.ratios, measured, own, fmt=".", color=colour, label=f"type {kind + 1}")
        if blur.tells_aperture:
            axes.plot(ratios, discs[kind], color=colour, linewidth=1)
            low = np.maximum(discs[kind] - errors[kind], 0)
            axes.fill_between(ratios, low, discs[kind] + errors[kind], color=colour, alpha=0.25)
    if len(blur.discs) > 1:
        axes.legend()
    axes.set(xlabel="s / D", xlim=(-reach, reach), ylim=(0, None), title="blur [px]")


def _draw_apertures(axes: Any, found: Assessment) -> None:
    lattice = found.calibration.lattice
    radius = found.microimages.radius.value
    index = np.stack(np.meshgrid(*[np.arange(-3, 4)] * 2), -1).reshape(-1, 2)
    draw_circles(axes, index @ lattice.basis, radius, TYPE_COLOURS[0])
    reach = 1.5 * _MARGIN * lattice.pitch
    axes.set(xlim=(-reach, reach), ylim=(reach, -reach), aspect="equal", xticks=[], yticks=[])
    axes.set_title(f"neighbours {2 * nearest_half(lattice):.2f} px apart, {2 * radius:.2f} px wide")


def _draw_vignetting(axes: Any, found: Assessment) -> None:
    camera = found.calibration
    title = "radius with half the light on all sides [px]"
    _map(axes, found, camera.lattice.centres(), camera.usable_radius(), title)


def _draw_exposure(axes: Any, found: Assessment) -> None:
    axes.fill_between(
        np.linspace(0, 100, len(found.histogram)),
        found.histogram,
        step="mid",
        color=TYPE_COLOURS[0],
    )
    axes.set(
        xlabel="value [% of the largest that pixels can have, or have]",
        yticks=[],
        yscale="symlog",
        title="pixels over their values",
    )


def _draw_evenness(axes: Any, found: Assessment) -> None:
    gain = found.calibration.gain_map
    lattice = found.calibration.lattice
    centres = lattice.centres()
    light = np.ones(len(centres)) if gain is None else gain.light(lattice.field_place(centres))
    _map(axes, found, centres, light, "light of the lenses")


def _draw_dirt(axes: Any, found: Assessment) -> None:
    defects = found.calibration.defects
    axes.plot(
        *defects.pixels[evenly(len(defects.pixels), ENOUGH_LENSES)].T,
        ".",
        color="firebrick",
        markersize=2,
    )
    axes.plot(
        *found.calibration.lattice.points(defects.lenses).T,
        "x",
        color=TYPE_COLOURS[0],
        markersize=4,
    )
    _frame(axes, found, "defective pixels (dots), unlit lenses (crosses)")


def _map(
    axes: Any, found: Assessment, places: Any, values: Any, title: str, size: float = 6
) -> None:
    every = evenly(len(places), ENOUGH_LENSES)
    drawn = axes.scatter(*places[every].T, c=values[every], s=size, cmap="viridis")
    bar = axes.figure.colorbar(drawn, ax=axes)
    # Whole values, not what they exceed another number by.
    bar.formatter.set_useOffset(False)
    _frame(axes, found, title)


def _frame(axes: Any, found: Assessment, title: str) -> None:
    width, height = found.calibration.image_size
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal", xticks=[], yticks=[], title=title)


_DRAWINGS = {
    "rotation": _draw_rotation,
    "tilt": _draw_tilt,
    "distance": _draw_distance,
    "apertures": _draw_apertures,
    "vignetting": _draw_vignetting,
    "exposure": _draw_exposure,
    "evenness": _draw_evenness,
    "dirt": _draw_dirt,
}
