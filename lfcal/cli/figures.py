"""The figures of a camera that commands print."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..camera.calibration import Calibration

__all__ = ["describe"]


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
