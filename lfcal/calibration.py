"""A calibrated camera: lattice, vignetting and how well they fit, with its JSON file."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .distortion import Distortion
from .errors import CameraFileError
from .lattice import Lattice
from .lens_types import LensTypes
from .outfile import whole_file
from .vignetting import Vignetting

__all__ = ["Calibration", "load"]

_SCHEMA = "lfcal-camera"
_VERSION = 1


@dataclass(frozen=True)
class Calibration:
    """Where the microimages of a camera are and what they can be used for.

    Parameters
    ----------
    lattice : Lattice
        Centres, pitch and usable radius.
    vignetting : Vignetting or None
        Illumination inside each microimage; None where it is flat or unknown.
    source : str
        What it was measured on: `"white"`, `"scene"`, `"published"` or `"truth"`.
    residual_rms : float [px]
        RMS distance of single microimages from the fitted lattice, NaN where not measured.
    lenses_used : int
        Microimages that took part in the fit.
    confidence : float
        0..1, how sure the lattice is the right one.
    warnings : tuple of str
        What a user should know before trusting it.
    lens_types : LensTypes or None
        Types of microlenses of a multi-focus array; None where there is one type, or more were not seen.
    mosaic : str or None
        Colour filters of the top left 2 x 2 pixels of its flats, row by row: `"RGGB"`, `"BGGR"`, `"GRBG"` or
        `"GBRG"`; None where flats have no colour mosaic or its colours are not known.
    """

    lattice: Lattice
    vignetting: Vignetting | None = None
    source: str = "published"
    residual_rms: float = float("nan")
    lenses_used: int = 0
    confidence: float = 1.0
    warnings: tuple[str, ...] = field(default=())
    lens_types: LensTypes | None = None
    mosaic: str | None = None

    def __post_init__(self) -> None:
        if self.mosaic not in (None, "RGGB", "BGGR", "GRBG", "GBRG"):
            raise ValueError(f"mosaic must be RGGB, BGGR, GRBG, GBRG or None, got {self.mosaic!r}")

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of the flats this camera makes [px]."""
        return self.lattice.image_size

    def to_dict(self) -> dict[str, Any]:
        """The camera as plain numbers and strings, as written by `save`."""
        vignetting = self.vignetting and {"step": self.vignetting.step, "profile": self.vignetting.profile.tolist()}
        return {
            "schema": _SCHEMA,
            "version": _VERSION,
            "image_size": list(self.image_size),
            "lattice": {
                "origin": self.lattice.origin.tolist(),
                "basis": self.lattice.basis.tolist(),
                "radius": self.lattice.radius,
                "pitch": self.lattice.pitch,
            }
            | _bend(self.lattice.distortion),
            "vignetting": vignetting,
            "source": self.source,
            "fit": {
                "residual_rms": None if np.isnan(self.residual_rms) else self.residual_rms,
                "lenses_used": self.lenses_used,
                "confidence": self.confidence,
            },
            "warnings": list(self.warnings),
        } | {
            key: value
            for key, value in (("lens_types", self.lens_types and self.lens_types.to_dict()), ("mosaic", self.mosaic))
            if value is not None
        }

    @classmethod
    def from_dict(cls, data: Any, where: str = "camera file") -> Calibration:
        """Rebuild a camera from `to_dict`; raises CameraFileError naming the field that is wrong."""
        if not isinstance(data, dict) or data.get("schema") != _SCHEMA:
            raise CameraFileError(f"{where}: not an {_SCHEMA} file; make one with 'lfcal calibrate IMAGE -o {where}'")
        if data.get("version") != _VERSION:
            raise CameraFileError(
                f"{where}: version {data.get('version')!r} is not known "
                f"(this toolkit reads {_VERSION}); calibrate again"
            )
        try:
            lattice, fit, vignetting = data["lattice"], data["fit"], data["vignetting"]
            residual = fit["residual_rms"]
            return cls(
                lattice=Lattice(
                    lattice["origin"],
                    lattice["basis"],
                    tuple(data["image_size"]),
                    lattice["radius"],
                    _unbend(lattice.get("distortion")),
                ),
                vignetting=vignetting and Vignetting(vignetting["profile"], vignetting["step"]),
                source=str(data["source"]),
                residual_rms=float("nan") if residual is None else float(residual),
                lenses_used=int(fit["lenses_used"]),
                confidence=float(fit["confidence"]),
                warnings=tuple(str(w) for w in data["warnings"]),
                lens_types=None if data.get("lens_types") is None else LensTypes.from_dict(data["lens_types"]),
                mosaic=data.get("mosaic"),
            )
        except KeyError as error:
            raise CameraFileError(f"{where}: field {error} is missing; calibrate again") from error
        except (TypeError, ValueError) as error:
            raise CameraFileError(f"{where}: {error}; calibrate again") from error

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the camera as JSON; the file appears whole or not at all."""
        with whole_file(path) as temporary:
            temporary.write_text(json.dumps(self.to_dict(), indent=2) + "\n", encoding="utf-8")


def _bend(distortion: Distortion | None) -> dict[str, Any]:
    """The entry of a distortion in a camera file; none for a straight lattice."""
    if distortion is None:
        return {}
    values: dict[str, Any] = {"k1": distortion.k1, "k2": distortion.k2, "reach": distortion.reach}
    bend = {"centre": distortion.centre.tolist()} | values
    if distortion.general is not None and distortion.middle is not None:
        bend |= {"general": distortion.general.tolist(), "middle": distortion.middle.tolist()}
    return {"distortion": bend}


def _unbend(data: Any) -> Distortion | None:
    """A distortion from its entry in a camera file; KeyError, TypeError or ValueError where that is wrong."""
    if data is None:
        return None
    return Distortion(data["centre"], data["k1"], data["k2"], data["reach"], data.get("general"), data.get("middle"))


def load(path: str | os.PathLike[str], image_size: tuple[int, int] | None = None) -> Calibration:
    """Read a camera file written by `Calibration.save`, or one published by others (see `read_published`).

    Parameters
    ----------
    path : path-like
    image_size : (int, int) or None [px]
        Width and height of the flats; needed only for published files that do not say.

    Raises
    ------
    CameraFileError
        If the file is missing, is not of a known kind, a field is wrong, or it belongs to another image size.
    """
    source = Path(path)
    try:
        text = source.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise CameraFileError(f"{source}: cannot be read as a camera file ({error})") from error
    if _looks_published(text):
        from .published import parse_published

        return parse_published(text, image_size, str(source))
    try:
        data = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise CameraFileError(f"{source}: not valid JSON ({error}); make one with 'lfcal calibrate'") from error
    camera = Calibration.from_dict(data, str(source))
    if image_size is not None and tuple(image_size) != camera.image_size:
        raise CameraFileError(
            f"{source}: is for flats of {camera.image_size[0]} x {camera.image_size[1]} px, "
            f"not of {image_size[0]} x {image_size[1]} px; calibrate on a flat of that size"
        )
    return camera


def _looks_published(text: str) -> bool:
    """Whether `text` is XML or begins with a line `key : number`."""
    first = next((line for line in text.splitlines() if line.strip()), "").strip()
    key, colon, value = first.partition(":")
    if first.startswith("<"):
        return True
    try:
        float(value)
    except ValueError:
        return False
    return bool(colon) and key.strip().isidentifier()
