"""The figures of a camera that commands print."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from ..runtime.types import Entries

if TYPE_CHECKING:
    from ..camera.calibration import Calibration
    from ..camera.lens_types import LensBlur
    from ..camera.optics import Optics

__all__ = ["describe", "describe_blur", "describe_optics", "summarise", "tell_all"]

# Lengths that all optics have, in words.
_DISTANCES = {
    "focal_length": "focal length",
    "mla_distance": "main lens to microlenses",
    "sensor_distance": "microlenses to sensor",
}
# Units of the parameters of optics that have one.
_UNITS = {
    **dict.fromkeys((*_DISTANCES, "pupil"), "mm"),
    **dict.fromkeys(("principal_x", "principal_y"), "px"),
    **dict.fromkeys(("tilt_x", "tilt_y"), "rad"),
}


def describe(camera: Calibration) -> Entries:
    """The figures of a calibration that commands print."""
    from ..lattice.lattice import describe_orientation

    lattice = camera.lattice
    types = camera.lens_types
    defects = camera.defects
    shape, rows, rotation = describe_orientation(lattice)
    # What others state was not measured here.
    confidence = None if camera.source == "published" else camera.confidence
    return {
        "size": camera.image_size,
        "lattice": shape,
        "rows": rows,
        "rotation_degrees": rotation,
        "pitch": lattice.pitch,
        "radius": lattice.radius,
        "origin": lattice.origin,
        "basis": lattice.basis,
        "lenses": len(lattice),
        "source": camera.source,
        "lens_types": types
        and {
            "count": types.count,
            "by_focus": types.ordered,
            "confidence": types.confidence,
            "focus": types.focus,
            "cell": types.cell,
        },
        "lenses_used": camera.lenses_used,
        "residual_rms": camera.residual_rms,
        "confidence": confidence,
        "proof": camera.evidence and camera.evidence.describe(),
        "evidence": camera.evidence and camera.evidence.to_dict(),
        "mosaic": camera.mosaic or "none",
        "defect_pixels": len(defects.pixels),
        "defect_lenses": len(defects.lenses),
        "lens_blur": camera.lens_blur and camera.lens_blur.to_dict(),
        "optics": camera.optics and describe_optics(camera.optics),
        "warnings": camera.warnings,
    }


def describe_optics(optics: Optics) -> Entries:
    """Focal length and distances [mm], and all else that was measured, with standard errors."""
    figures: Entries = {}
    for name, value, error in _measured(optics):
        unit = _UNITS.get(name, "")
        key = f"{name}_{unit}" if unit in ("mm", "px") else name
        figures[key] = float(f"{value:.8g}")
        if error > 0:
            figures[f"{key}_error"] = float(f"{error:.2g}")
    return {**figures, "microlens_focal_lengths_mm": optics.microlens_focal_lengths}


def _measured(optics: Optics) -> Iterator[tuple[str, float, float]]:
    """Name, value and standard error of focal length, distances, and all else with an error."""
    from ..camera.optics import OPTICS_PARAMETERS

    errors = optics.standard_errors
    for number, name in enumerate(OPTICS_PARAMETERS):
        if errors[number] > 0 or number < len(_DISTANCES):
            yield name, optics.parameters[number], errors[number]


def _tell_optics(optics: Optics) -> str:
    """All that was measured of the optics, with standard errors, in a sentence."""
    told = []
    for name, value, error in _measured(optics):
        text = f"{value:.5g}"
        if error > 0:
            # Two digits of the error.
            digits = max(0, 1 - math.floor(math.log10(error)))
            text = f"{value:.{digits}f} +- {error:.{digits}f}"
        words = _DISTANCES.get(name, name.replace("_", " "))
        told.append(f"{words} {text} {_UNITS.get(name, '')}".rstrip())
    return f"Optics: {', '.join(told)}; pixels of {1000 * optics.pixel:.4g} um."


def tell_all(camera: Calibration) -> list[str]:
    """All that is in a camera file, in sentences; what is not known is left out."""
    from ..lattice.lattice import describe_orientation

    lattice = camera.lattice
    types = camera.lens_types
    sentences = summarise(camera)
    width, height = camera.image_size
    (x, y), steps = lattice.origin, [f"({dx:+.4f}, {dy:+.4f})" for dx, dy in lattice.basis]
    rows = describe_orientation(lattice)[1]
    sentences[1:1] = [
        f"Flats have {width} x {height} px. Rows of lenses are {rows}; microimage (0, 0) has its "
        f"centre at x {x:.3f}, y {y:.3f} px, and the next ones lie {' and '.join(steps)} px from "
        f"it. Microimages are used up to {lattice.radius:.2f} px from their centres.",
    ]
    if camera.lenses_used:
        sentences.append(
            f"{camera.lenses_used:,} microimages were fitted, and lie {camera.residual_rms:.3f} px "
            "(RMS) from the lattice."
        )
    if types is not None:
        cell = ", ".join(" ".join(map(str, row)) for row in types.cell)
        told = f"Lens types repeat as {cell}"
        if camera.source != "published":
            told += f", confidence {100 * types.confidence:.0f} %"
        foci = [f"{focus:.3f} D" for focus in types.to_dict()["focus"] if focus is not None]
        if foci:
            told += f"; they are in focus at s = {', '.join(foci)}"
        sentences.append(f"{told}.")
    if camera.mosaic is not None:
        sentences.append(f"Colour filters of the top left 2 x 2 pixels: {camera.mosaic}.")
    if camera.optics is not None:
        sentences.append(_tell_optics(camera.optics))
    return sentences


def summarise(camera: Calibration) -> list[str]:
    """What a camera file holds, in sentences."""
    from ..lattice.lattice import describe_orientation

    shape, _, rotation = describe_orientation(camera.lattice)
    sources = {
        "white": "Measured on a white image",
        "scene": "Measured on a capture",
        "published": "As published",
    }
    told = sources.get(camera.source, f"From {camera.source}")
    if camera.source != "published":
        told += f", confidence {camera.confidence_text}"
    if camera.lens_types is not None:
        told += f"; {camera.lens_types.count} types of lenses"
    counts = (
        (len(camera.defects.pixels), "defective pixels"),
        (len(camera.defects.lenses), "unlit lenses"),
    )
    told += "".join(f"; {number:,} {what}" for number, what in counts if number)
    lenses = f"{len(camera.lattice):,} microlenses, {camera.lattice.pitch:.2f} px apart"
    sentences = [f"{lenses}: a {shape} lattice turned by {rotation:.2f} degrees.", f"{told}."]
    if camera.evidence is not None:
        sentences.append(f"Evidence for the lattice: {camera.evidence.describe()}.")
    if camera.lens_blur is not None:
        sentences.append(describe_blur(camera.lens_blur))
    return sentences


def describe_blur(blur: LensBlur) -> str:
    """Where the microlenses are in focus, and how wide their discs are, by lens type."""
    if not blur.tells_aperture:
        ratio = float(min(blur.ratios, key=abs))
        where = f"Places at s = {ratio:.2f} D"
        if ratio == 0:
            where = "Rims of microimages"
        discs = " / ".join(f"{disc:.1f}" for disc in blur.at([ratio])[0][:, 0])
        return (
            f"{where} are blurred over {discs} px; what microlenses blur elsewhere is "
            "measured on each capture."
        )
    ratio = float(max(blur.ratios, key=lambda one: abs(one - blur.focus).max()))
    foci = " / ".join(f"{focus:.2f}" for focus in blur.focus)
    discs = " / ".join(f"{disc:.1f}" for disc in blur.at([ratio])[0][:, 0])
    return f"Microlenses are in focus at s = {foci} D; their blur is {discs} px at {ratio:.2f} D."
