"""The figures of a camera that commands print."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..runtime.types import Entries

if TYPE_CHECKING:
    from ..camera.calibration import Calibration
    from ..camera.lens_types import LensBlur
    from ..camera.optics import Optics

__all__ = ["describe", "describe_blur", "describe_optics", "summarise"]


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
    from ..camera.optics import OPTICS_PARAMETERS

    lengths = ("focal_length", "mla_distance", "sensor_distance", "pupil")
    figures: Entries = {}
    for name, value, error in zip(
        OPTICS_PARAMETERS, optics.parameters, optics.standard_errors, strict=True
    ):
        unit = ""
        if name in lengths:
            unit = "_mm"
        elif name.startswith("principal"):
            unit = "_px"
        if error > 0 or name in lengths[:3]:
            figures[name + unit] = float(f"{value:.8g}")
        if error > 0:
            figures[name + unit + "_error"] = float(f"{error:.2g}")
    return {**figures, "microlens_focal_lengths_mm": optics.microlens_focal_lengths}


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
