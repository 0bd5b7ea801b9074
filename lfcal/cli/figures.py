"""The figures of a camera that commands print."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..camera.calibration import Calibration

__all__ = ["describe", "summarise"]


def describe(camera: Calibration) -> dict[str, Any]:
    """The figures of a calibration that commands print."""
    from ..lattice.orientation import describe_orientation

    lattice, types = camera.lattice, camera.lens_types
    shape, rows, rotation = describe_orientation(lattice)
    return {
        "size": list(camera.image_size),
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
        "confidence": camera.confidence,
        "circle_agreement": camera.circle_agreement,
        "mosaic": camera.mosaic or "none",
        "defect_pixels": len(camera.defects.pixels),
        "defect_lenses": len(camera.defects.lenses),
        "warnings": list(camera.warnings),
    }


def summarise(camera: Calibration) -> list[str]:
    """What a camera file holds, in sentences."""
    from ..lattice.orientation import describe_orientation

    shape, _, rotation = describe_orientation(camera.lattice)
    sources = {"white": "measured on a white image", "scene": "measured on a capture", "published": "as published"}
    how = sources.get(camera.source, f"from {camera.source}")
    lenses = f"{len(camera.lattice):,} microlenses, {camera.lattice.pitch:.2f} px apart"
    sentences = [f"{lenses}: a {shape} lattice turned by {rotation:.2f} degrees."]
    sure = "" if camera.source == "published" else f", confidence {100 * camera.confidence:.0f} %"
    if camera.lens_types is not None:
        sure += f"; {camera.lens_types.count} types of lenses"
    defects = len(camera.defects.pixels) + len(camera.defects.lenses)
    sentences.append(f"{how[:1].upper()}{how[1:]}{sure}{f'; {defects:,} defects' if defects else ''}.")
    return sentences
