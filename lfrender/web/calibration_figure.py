"""The calibration over its flat: enlarged crops with circles, offsets of regions, light of a microimage, as vectors.

Every panel is a figure of its own, so that a page lays them out side by side or below each other.
"""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, check_fit

from .report_figures import png_url, webp_url

__all__ = ["calibration_panels", "enlarged_crop"]

_TYPES = ("#5cb8ff", "#ff6fb5", "#7be07b", "#ffd84d")  # circles of lens types
_SIDE = 320  # of a panel, in its own units


def calibration_panels(flat: NDArray, calibration: Calibration, pitches: float = 6.0) -> str:
    """HTML of the panels: crops of three places, `pitches` across, and what was measured.

    FlatError if the flat is not of the size the calibration is for.
    """
    width, height = calibration.image_size
    places = {
        "Top left": (0.0, 0.0), "Centre": (width / 2, height / 2), "Bottom right": (float(width), float(height)),
    }  # fmt: skip
    figures = [
        _figure(_crop(flat, calibration, np.array(place), pitches), f"<b>{name}.</b> {_CIRCLES if not n else ''}")
        for n, (name, place) in enumerate(places.items())
    ]
    fit = check_fit(calibration, flat)
    figures.append(
        _figure(_offsets(calibration, fit), f"<b>Offsets of regions [px].</b> {escape(_sentence(fit.verdict))}")
    )
    figures.append(_figure(_falloff(calibration), _FALLOFF))
    if calibration.gain_map is not None:
        figures.append(_figure(_gain(calibration), _gain_caption(calibration)))
    return "".join(figures)


_CIRCLES = (
    "Circles are the usable parts of the microimages; they should lie on those of the flat. Lens types have colours."
)
_FALLOFF = (
    "<b>Light inside a microimage</b>, over the distance from its centre [px]. R is the usable radius: pixels beyond "
    "are not used."
)


def enlarged_crop(flat: NDArray, middle: NDArray[np.float64], side: float) -> str:
    """SVG of the part of a flat about a place, `side` pixels across, with all its contrast."""
    return _svg_of_crop(flat, middle, side, "")


def _figure(drawing: str, caption: str) -> str:
    return f"<figure>{drawing}<figcaption>{caption}</figcaption></figure>"


def _sentence(words: str) -> str:
    return f"{words[:1].upper()}{words[1:]}."


def _svg_of_crop(
    flat: NDArray, middle: NDArray[np.float64], side: float, over: str, label: str = "Part of the flat"
) -> str:
    """A crop with `over` drawn over it, in pixels of the flat."""
    size = np.array(flat.shape[1::-1])
    reach = np.minimum(np.round(side).astype(int), size)
    low = np.clip(np.round(middle - reach / 2).astype(int), 0, size - reach)
    values = np.nan_to_num(flat[low[1] : low[1] + reach[1], low[0] : low[0] + reach[0]].astype(np.float32))
    dark, bright = np.percentile(values, (1, 99))
    shown = np.rint(255 * np.clip((values - dark) / max(bright - dark, 1e-6), 0, 1) ** (1 / 1.4)).astype(np.uint8)
    x, y = low - 0.5
    return (
        f'<svg class="crop" viewBox="{x} {y} {reach[0]} {reach[1]}" role="img" aria-label="{escape(label)}">'
        f'<image href="{webp_url(shown)}" x="{x}" y="{y}" width="{reach[0]}" height="{reach[1]}" '
        f'preserveAspectRatio="none"/>{over}</svg>'
    )


def _crop(flat: NDArray, calibration: Calibration, middle: NDArray[np.float64], pitches: float) -> str:
    lattice = calibration.lattice
    side = pitches * lattice.pitch
    low = np.clip(middle - side / 2, 0, np.maximum(np.array(lattice.image_size) - side, 0))
    centres, types = lattice.centres(), calibration.lens_types
    near = ((centres > low - lattice.pitch) & (centres < low + side + lattice.pitch)).all(1)
    kinds = np.zeros(near.sum(), int) if types is None else types.of(lattice.indices()[near]) % len(_TYPES)
    circles = "".join(
        f'<circle cx="{x:.2f}" cy="{y:.2f}" r="{lattice.radius:.2f}" stroke="{_TYPES[kind]}"/>'
        f'<path d="M{x - 1:.2f} {y:.2f}h2M{x:.2f} {y - 1:.2f}v2" stroke="#fff"/>'
        for (x, y), kind in zip(centres[near], kinds, strict=True)
    )
    reach = lattice.radius / np.sqrt(2)
    unlit = "".join(
        f'<path d="M{x - reach:.2f} {y - reach:.2f}l{2 * reach:.2f} {2 * reach:.2f}'
        f'm0 {-2 * reach:.2f}l{-2 * reach:.2f} {2 * reach:.2f}" stroke="#f44"/>'
        for x, y in lattice.points(calibration.defects.lenses)
        if (np.abs((x, y) - low - side / 2) < side / 2 + lattice.pitch).all()
    )
    return _svg_of_crop(flat, middle, side, f"<g>{circles}{unlit}</g>", "Microimages with their calibrated circles")


def _offsets(calibration: Calibration, fit: Any) -> str:
    """Arrows from the centres of the lattice to those that nine regions of the flat show."""
    width, height = calibration.image_size
    scale = (_SIDE - 40) / max(width, height)
    positions, offsets = fit.positions.reshape(-1, 2), fit.offset.reshape(-1, 2)
    lengths = np.linalg.norm(offsets, axis=-1)
    enlarge = 0.11 * _SIDE / max(float(np.nanmax(lengths, initial=0.0)), 1e-3)
    left, top = (_SIDE - scale * width) / 2, (_SIDE - scale * height) / 2
    parts = [f'<rect x="{left:.1f}" y="{top:.1f}" width="{scale * width:.1f}" height="{scale * height:.1f}"/>']
    for position, offset, length in zip(positions, offsets, lengths, strict=True):
        x, y = (left, top) + scale * (position + 0.5)
        known = np.isfinite(length)
        if known:
            end = (x, y) + enlarge * offset
            parts.append(f'<path class="arrow" d="M{x:.1f} {y:.1f}L{end[0]:.1f} {end[1]:.1f}"/>')
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5"/>')
        parts.append(
            f'<text x="{x:.1f}" y="{y + 20:.1f}" text-anchor="middle">{f"{length:.2f}" if known else "?"}</text>'
        )
    return _plot("".join(parts), "Offsets of nine regions of the flat from the lattice")


def _falloff(calibration: Calibration) -> str:
    vignetting, radius = calibration.vignetting, calibration.lattice.radius
    if vignetting is None:
        return _plot(
            f'<text x="{_SIDE / 2}" y="{_SIDE / 2}" text-anchor="middle">not measured</text>', "No light measured"
        )
    end = max(float((len(vignetting.profile) - 1) * vignetting.step), 1.05 * radius)
    left, right, low, high = 44, _SIDE - 16, _SIDE - 36, 24

    def at(distance: float, light: float) -> tuple[float, float]:
        return left + (right - left) * distance / end, low + (high - low) * light

    parts = []
    for level in (0, 0.5, 1):
        y = at(0, level)[1]
        parts.append(f'<path class="grid" d="M{left} {y:.1f}H{right}"/>')
        parts.append(f'<text x="{left - 8}" y="{y + 4:.1f}" text-anchor="end">{level:g}</text>')
    for share in (0, 0.5, 1):
        parts.append(
            f'<text x="{at(share * end, 0)[0]:.1f}" y="{low + 20}" text-anchor="middle">{share * end:.1f}</text>'
        )
    x = at(radius, 0)[0]
    parts.append(f'<path class="limit" d="M{x:.1f} {low}V{high}"/>')
    parts.append(f'<text x="{x - 6:.1f}" y="{low - 8}" text-anchor="end">R {radius:.1f}</text>')
    points = (at(n * vignetting.step, float(light)) for n, light in enumerate(vignetting.profile))
    parts.append(f'<polyline points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in points)}"/>')
    return _plot("".join(parts), "Relative light over the distance from the centre of a microimage")


def _plot(content: str, label: str) -> str:
    return f'<svg class="plot" viewBox="0 0 {_SIDE} {_SIDE}" role="img" aria-label="{escape(label)}">{content}</svg>'


def _gain(calibration: Calibration) -> str:
    """The gain map over a corner of the flat of some microimages, unknown pixels in pink."""
    side = int(max(8, 6 * calibration.lattice.pitch))
    gain = calibration.gain()[:side, :side]
    drawn = np.repeat(np.rint(255 * np.clip(np.nan_to_num(gain), 0, 1)).astype(np.uint8)[..., None], 3, axis=2)
    drawn[np.isnan(gain)] = (214, 110, 160)
    return f'<img class="map pixels" src="{png_url(drawn)}" alt="Gain map of the top left corner">'


def _gain_caption(calibration: Calibration) -> str:
    defects = calibration.defects
    found = f"{len(defects.pixels):,} pixels and {len(defects.lenses):,} lenses are defective."
    return (
        "<b>Gain map</b>, top left corner: the share of the light that each pixel gets. Flats are divided by it. Pink: "
        f"unknown, the gaps between microimages. {found}"
    )
