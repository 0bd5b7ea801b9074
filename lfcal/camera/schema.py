"""Checks of the fields of a camera file: types, ranges, and whether they fit together."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, Struct

from ..gain.gain_map import GainMap, Vignetting, largest_values
from ..lattice.lattice import Lattice
from ..runtime.errors import CameraFileError
from ..runtime.image_formats import Mosaic
from .evidence import Evidence

__all__ = ["check_plausible", "check_together", "read_fields"]

_Number = Annotated[float, Meta(ge=-1e9, le=1e9)]
_Length = Annotated[float, Meta(gt=0, le=1e9)]
_Share = Annotated[float, Meta(ge=0, le=1)]
_Count = Annotated[int, Meta(ge=0, lt=2**31)]
_Side = Annotated[int, Meta(ge=1, lt=2**31)]
# A text that can be printed: surrogates without their partner cannot.
_Text = Annotated[str, Meta(max_length=1_000_000, pattern=r"^[^\ud800-\udfff]*$")]
_Point = tuple[_Number, _Number]
_Gain = Annotated[float, Meta(gt=0, le=1e3)]
_Table = list[list[_Number]]
# Figures of the evidence are shares, correlations, logarithms and numbers of deviations.
_MOST_FIGURE = 1e6
# Fields of gain maps that have other names in camera files.
_NAMES_IN_FILES = {
    "stray_light": "dark",
    "type_light": "types.light",
    "lens_gain": "own",
    "shading": "shade",
}
# Least usable radius over the distance of neighbours; closed apertures of simulations have 0.1.
_LEAST_RADIUS = 0.05
# Largest relative difference of the pitch in a file, which has few digits at times, from its basis.
_PITCH_ERROR = 0.01


class _Distortion(Struct):
    centre: _Point
    k1: _Number
    k2: _Number
    reach: _Length
    general: _Table | None = None
    middle: _Point | None = None


class _Lattice(Struct):
    origin: _Point
    basis: tuple[_Point, _Point]
    radius: _Number
    pitch: _Number | None = None
    distortion: _Distortion | None = None


class _Vignetting(Struct):
    step: _Length
    profile: list[_Number]


class _Fit(Struct):
    residual_rms: Annotated[float, Meta(ge=0, le=1e5)] | None
    lenses_used: _Count
    confidence: _Share


class _LensTypes(Struct):
    cell: list[list[_Count]]
    ordered: bool
    focus: list[_Number | None]
    confidence: _Share


class _GainMap(Struct):
    profile: str
    step: _Length
    radius: _Length
    level: list[_Number]
    own: str
    shade: _Table
    rim: _Table
    cut: list[_Number]
    dark: _Number
    types: dict[str, Any] | None = None


class _LatticeErrors(Struct):
    names: list[str]
    covariance: _Table


class _Camera(Struct):
    image_size: tuple[_Side, _Side]
    lattice: _Lattice
    vignetting: _Vignetting | None
    source: Annotated[str, Meta(min_length=1, max_length=100, pattern=r"^[^\ud800-\udfff]*$")]
    fit: _Fit
    warnings: list[_Text]
    # Files of earlier versions do not have the following fields.
    mosaic: Mosaic | None = None
    white_level: Annotated[float, Meta(ge=1, lt=2**53)] | None = None
    encoded: bool | None = None
    mosaic_guessed: bool = False
    white_balance: tuple[_Gain, _Gain, _Gain] | None = None
    flats: tuple[_Text, ...] = ()
    lens_types: _LensTypes | None = None
    gain_map: _GainMap | None = None
    errors: _LatticeErrors | None = None
    evidence: Evidence | None = None
    # Packed blocks, and records that check their numbers themselves, as other files hold them too.
    defects: dict[str, str] | None = None
    residuals: dict[str, str] | None = None
    optics: dict[str, Any] | None = None
    lens_blur: dict[str, Any] | None = None


def read_fields(data: dict[str, Any]) -> Any:
    """The fields; CameraFileError with the name of the first one of a wrong type or value."""
    try:
        return msgspec.convert(data, _Camera)
    except msgspec.ValidationError as error:
        reason, _, place = str(error).partition(" - at ")
        name = place.strip("`").removeprefix("$").lstrip(".")
        raise CameraFileError(
            f"field {name or 'of the camera'}: {reason}; calibrate again"
        ) from error


def check_together(
    lattice: Lattice,
    pitch: float | None,
    gain: GainMap | None,
    vignetting: Vignetting | None,
    evidence: Evidence | None,
) -> None:
    """Raise CameraFileError with the name of a field that does not fit the lattice.

    `pitch` [px] is the pitch that the file states.
    """
    check_plausible(lattice)
    if pitch is not None and not abs(pitch / lattice.pitch - 1) <= _PITCH_ERROR:
        raise _misfit(
            "lattice.pitch", f"{pitch:.6g} px are not the {lattice.pitch:.6g} px of lattice.basis"
        )
    if vignetting is not None:
        _check_lengths(lattice, {"vignetting.step": vignetting.step})
        largest = largest_values(lattice)["profile"]
        _check_largest("vignetting.profile", vignetting.profile, largest)
    if gain is not None:
        _check_lengths(lattice, {"gain_map.radius": gain.radius, "gain_map.step": gain.step})
        for name, largest in largest_values(lattice).items():
            field = f"gain_map.{_NAMES_IN_FILES.get(name, name)}"
            _check_largest(field, getattr(gain, name), largest)
    for name, figure in vars(evidence).items() if evidence is not None else ():
        # Halves of a flat to which no lattice fits differ by infinity.
        _check_largest(f"evidence.{name}", np.nan_to_num(figure or 0, posinf=0), _MOST_FIGURE)


def _check_largest(field: str, values: Any, largest: float) -> None:
    """Raise CameraFileError if the size of one of the values exceeds the largest one."""
    found = float(np.abs(values).max(initial=0))
    if not found <= largest:
        raise _misfit(field, f"{found:.3g} is not between -{largest:g} and {largest:g}")


def check_plausible(lattice: Lattice) -> None:
    """Raise CameraFileError with the name of a field of the lattice that cannot be right."""
    steps = np.hypot(*(lattice.steps @ lattice.basis).T)
    side = max(lattice.image_size)
    bend = lattice.distortion
    # Microimages of less than a pixel show nothing.
    if not 1 <= steps.min() <= steps.max() <= side:
        apart = f"{steps.min():.6g} to {steps.max():.6g} px apart"
        size = "{} x {}".format(*lattice.image_size)
        raise _misfit("lattice.basis", f"microimages {apart} do not fit a flat of {size} px")
    _check_lengths(lattice, {"lattice.radius": lattice.radius})
    # Apertures that leave less light show no scene.
    if lattice.radius < _LEAST_RADIUS * steps.min():
        raise _misfit("lattice.radius", f"no lens has {lattice.radius:.6g} px in {steps.min():.6g}")
    if bend is not None and np.abs(bend.centre).max() > 100 * side:
        raise _misfit("lattice.distortion.centre", f"{bend.centre.tolist()} is far off the flat")
    if bend is not None and not side / 100 < bend.reach < 100 * side:
        raise _misfit(
            "lattice.distortion.reach", f"{bend.reach:.6g} px is not about half the diagonal"
        )


def _check_lengths(lattice: Lattice, lengths: dict[str, float]) -> None:
    """Raise CameraFileError if a length exceeds the distance from one microimage to the next.

    A microimage reaches at most to the corner of its cell, at 0.71 of the step of a square array.
    """
    longest = float(np.hypot(*(lattice.steps @ lattice.basis).T).max())
    for field, length in lengths.items():
        if length > longest:
            reason = f"{length:.6g} px are more than the {longest:.6g} px"
            raise _misfit(field, f"{reason} from one microimage to the next")


def _misfit(field: str, reason: str) -> CameraFileError:
    return CameraFileError(f"field {field}: {reason}; calibrate again")
