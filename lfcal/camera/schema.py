"""Schema of the fields of a camera file, which are checked before a camera is made of them.

Types and ranges of single fields are those of the structures below; which values make sense together is checked after
them. Packed blocks and covariances are checked where they are unpacked.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta, Struct

from ..lattice.lattice import Lattice
from ..runtime.errors import CameraFileError

__all__ = ["check_fields", "check_plausible", "check_together"]

_Length = Annotated[float, Meta(gt=0, le=1e5)]  # [px]
_Coordinate = Annotated[float, Meta(ge=-1e7, le=1e7)]  # [px]
_Share = Annotated[float, Meta(ge=0, le=1)]
_Point = tuple[_Coordinate, _Coordinate]
_Side = Annotated[int, Meta(ge=1, le=1_000_000)]  # [px]
_Values = list[float]
# A microimage reaches at most to the corner of its cell, at 0.71 of the longer step of a square array.
_LARGEST_RADIUS = 1.0  # [longest step]
# [px] from one microimage to the next: nearer ones would show nothing, and a flat have millions of them
_SHORTEST_STEP = 1.0
# The pitch is written for people, with fewer digits at times.
_SAME_PITCH = 0.01


class _Distortion(Struct):
    centre: _Point
    k1: Annotated[float, Meta(ge=-1, le=1)]
    k2: Annotated[float, Meta(ge=-1, le=1)]
    reach: Annotated[float, Meta(gt=0, le=1e7)]
    general: tuple[list[_Coordinate], list[_Coordinate]] | None = None
    middle: _Point | None = None


class _Lattice(Struct):
    origin: _Point
    basis: tuple[_Point, _Point]
    radius: _Length
    pitch: _Length | None = None
    distortion: _Distortion | None = None


class _Fit(Struct):
    residual_rms: Annotated[float, Meta(ge=0, le=1e5)] | None
    lenses_used: Annotated[int, Meta(ge=0)]
    confidence: _Share
    circle_agreement: Annotated[float, Meta(ge=-1, le=1)] | None = None


class _Vignetting(Struct):
    step: _Length
    profile: Annotated[list[Annotated[float, Meta(ge=0, le=1e6)]], Meta(min_length=1)]


class _LensTypes(Struct):
    cell: list[list[Annotated[int, Meta(ge=0, le=127)]]]
    ordered: bool
    focus: list[Annotated[float, Meta(ge=-100, le=100)] | None]
    confidence: _Share


class _TypeLight(Struct):
    cell: list[list[Annotated[int, Meta(ge=0, le=127)]]]
    light: str


class _GainMap(Struct):
    profile: str
    step: _Length
    radius: _Length
    level: _Values
    own: str
    shade: list[_Values]
    rim: list[_Values]
    cut: _Values
    dark: float
    # Files of earlier versions have none.
    types: _TypeLight | None = None


class _Packed(Struct):
    pixels: str
    lenses: str


class _Errors(Struct):
    names: list[str]
    covariance: list[_Values]


class _Residuals(Struct):
    indices: str
    offset: str


class _Camera(Struct):
    image_size: tuple[_Side, _Side]
    lattice: _Lattice
    vignetting: _Vignetting | None
    source: Annotated[str, Meta(min_length=1, max_length=100)]
    fit: _Fit
    warnings: list[str]
    # Files of earlier versions have none of these.
    lens_types: _LensTypes | None = None
    mosaic: Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None = None
    gain_map: _GainMap | None = None
    defects: _Packed | None = None
    errors: _Errors | None = None
    residuals: _Residuals | None = None
    white_level: Annotated[float, Meta(gt=0, lt=2**53)] | None = None
    optics: dict[str, Any] | None = None
    lens_blur: dict[str, Any] | None = None
    encoded: bool | None = None
    mosaic_guessed: bool = False


def check_fields(data: dict[str, Any]) -> None:
    """Raise CameraFileError with the name of the first field that has a wrong type or an impossible value."""
    try:
        msgspec.convert(data, _Camera)
    except msgspec.ValidationError as error:
        reason, _, place = str(error).partition(" - at ")
        name = place.strip("`").removeprefix("$").lstrip(".")
        raise CameraFileError(f"field {name or 'of the camera'}: {reason}; calibrate again") from error
    name = _find_not_finite(data, "")
    if name:
        raise CameraFileError(f"field {name} is not a finite number; calibrate again")


def _find_not_finite(value: Any, name: str) -> str:
    """Name of the first number that is NaN or infinite, else nothing."""
    if isinstance(value, float):
        return "" if np.isfinite(value) else name
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, one in inner:
        place = f"{name}[{key}]" if isinstance(value, list) else f"{name}.{key}".lstrip(".")
        if found := _find_not_finite(one, place):
            return found
    return ""


def check_together(data: dict[str, Any], lattice: Lattice) -> None:
    """Raise CameraFileError with the name of a field whose size does not fit the `lattice`."""
    check_plausible(lattice)
    pitch = data["lattice"].get("pitch")
    if pitch is not None and abs(pitch / lattice.pitch - 1) > _SAME_PITCH:
        raise CameraFileError(
            f"field lattice.pitch: {pitch:.6g} px are not the {lattice.pitch:.6g} px of lattice.basis; calibrate again"
        )
    longest = float(np.hypot(*(lattice.steps @ lattice.basis).T).max())
    for part, key in (("gain_map", "radius"), ("gain_map", "step"), ("vignetting", "step")):
        value = (data.get(part) or {}).get(key, 0)
        if value > _LARGEST_RADIUS * longest:
            raise CameraFileError(
                f"field {part}.{key}: {value:.6g} px are more than the {longest:.6g} px from one microimage to the "
                "next; calibrate again"
            )


def check_plausible(lattice: Lattice) -> None:
    """Raise CameraFileError with the name of a field of the lattice that does not fit the others."""
    steps = np.hypot(*(lattice.steps @ lattice.basis).T)
    if steps.min() < _SHORTEST_STEP:
        raise CameraFileError(
            f"field lattice.basis: microimages {steps.min():.3g} px apart are too near each other; calibrate again"
        )
    longest, side = float(steps.max()), max(lattice.image_size)
    if longest > side:
        raise CameraFileError(
            f"field lattice.basis: microimages {longest:.6g} px apart do not fit a flat of "
            f"{lattice.image_size[0]} x {lattice.image_size[1]} px; calibrate again"
        )
    if lattice.radius > _LARGEST_RADIUS * longest:
        raise CameraFileError(
            f"field lattice.radius: {lattice.radius:.6g} px are more than the {longest:.6g} px from one microimage to "
            "the next; calibrate again"
        )
    bend = lattice.distortion
    if bend is not None and np.abs(bend.centre).max() > 100 * side:
        raise CameraFileError(
            f"field lattice.distortion.centre: {bend.centre.tolist()} is far off the flat; calibrate again"
        )
    if bend is not None and not side / 100 < bend.reach < 100 * side:
        raise CameraFileError(
            f"field lattice.distortion.reach: {bend.reach:.6g} px is not about half the diagonal; calibrate again"
        )
