"""A calibrated camera: lattice, light and uncertainties, as a JSON file (docs/formats.md)."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..gain.gain_map import Defects, GainMap, Vignetting
from ..gain.rows import RegionGain
from ..lattice.cell import Cell
from ..lattice.distortion import Distortion
from ..lattice.lattice import Lattice, describe_orientation
from ..lattice.standard_errors import LatticeErrors, Residuals
from ..runtime.arrays import Array, Frozen, digest_arrays
from ..runtime.errors import CalibrationError, CameraFileError, FlatError, check_number, check_type
from ..runtime.image_formats import MOSAICS, Mosaic
from ..runtime.output_file import atomic_write
from ..runtime.page import html_card
from .evidence import Evidence
from .lens_types import LensBlur, LensTypes
from .optics import Optics

__all__ = ["Calibration"]

_SCHEMA = "lfcal-camera"
_VERSION = 2
# In files of this version the lenses of a gain map are always in rows of `j`.
_ROW_ORDER_VERSION = 1
# Fields that are records, with their types.
_PARTS: dict[str, Any] = {
    "lens_types": LensTypes,
    "gain_map": GainMap,
    "defects": Defects,
    "errors": LatticeErrors,
    "residuals": Residuals,
    "optics": Optics,
    "lens_blur": LensBlur,
}
# Fields that are stored as they are, and fields of the fit, whose NaN is stored as null.
_VALUES = ("source", "mosaic", "mosaic_guessed", "white_level", "encoded", "white_balance", "flats")
_FIT = ("residual_rms", "lenses_used", "confidence")
# Largest confidence that is stated of a lattice that was found.
_MOST_CONFIDENCE = 0.999


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Frozen):
    """Positions and light of the microimages of a camera, and the uncertainty of both.

    Methods for gain raise CalibrationError if the camera has neither gain map nor vignetting.

    Parameters
    ----------
    lattice : Lattice
        Centres, pitch and usable radius.
    vignetting : Vignetting or None
        Mean light inside microimages over the distance to their centre, which matching divides by.
        Light of neighbours may make it rise at the rim.
    source : str
        Kind of data that the lattice comes from: `"white"`, `"scene"`, `"published"` or `"truth"`.
    residual_rms : float [px]
        RMS distance of single microimages from the fitted lattice, NaN if not measured.
    lenses_used : int
        Number of microimages in the fit.
    confidence : float
        0..1, confidence that this is the lattice of the microimages.
    warnings : tuple of str
        Doubts that a user should read before using the camera.
    lens_types : LensTypes or None
        Types of microlenses of a multi-focus array; None if one type was found.
    mosaic : str or None
        Colour filters of the top left 2 x 2 pixels of its flats, row by row: `"RGGB"`, `"BGGR"`,
        `"GRBG"`, `"GBRG"`.
    gain_map : GainMap or None
        Relative illumination at every position in every microimage.
    defects : Defects
        Defect pixels and unlit lenses.
    errors : LatticeErrors or None
        Standard errors of the parameters and centres of the lattice.
    residuals : Residuals or None
        Measured centres of single microimages minus those of the lattice; None if single
        microimages do not show their centres, as in scenes.
    white_level : float or None
        Largest value of its flats if it is smaller than that of their type, such as 4095 for 12
        bits in files of 16.
    optics : Optics or None
        Main lens, distances and their covariance, which turn patch sizes into metres.
    evidence : Evidence or None
        Figures of the flat that support this lattice; None if it was not measured on a flat.
    lens_blur : LensBlur or None
        Blur of the microlenses, which is removed from pictures with `detail`.
    encoded : bool or None
        True if its flats are encoded for display, about as the square root of light, False if they
        are linear; None if this follows from their type (8 bits are encoded).
    mosaic_guessed : bool
        True if the colour filters were found on a flat, which does not tell red from blue.
    white_balance : (float, float, float) or None
        Gains of red, green and blue that make its white image behind these filters grey.
    flats : tuple of str
        Digests of the flats that show for sure that this is their lattice: `is_own` knows them.

    Examples
    --------
    >>> from lfcal import Calibration, Lattice
    >>> camera = Calibration(Lattice([10, 12], [[20, 0], [0, 20]], (200, 100), 9.5))
    >>> camera.image_size, len(camera.lattice)
    ((200, 100), 50)
    >>> Calibration.from_dict(camera.to_dict()).lattice.pitch
    20.0
    """

    lattice: Lattice
    vignetting: Vignetting | None = None
    source: str = "published"
    residual_rms: float = float("nan")
    lenses_used: int = 0
    confidence: float = 1.0
    warnings: tuple[str, ...] = field(default=())
    lens_types: LensTypes | None = None
    mosaic: Mosaic | None = None
    gain_map: GainMap | None = None
    defects: Defects = field(default_factory=Defects)
    errors: LatticeErrors | None = None
    residuals: Residuals | None = None
    white_level: float | None = None
    optics: Optics | None = None
    evidence: Evidence | None = None
    lens_blur: LensBlur | None = None
    encoded: bool | None = None
    mosaic_guessed: bool = False
    white_balance: tuple[float, float, float] | None = None
    flats: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_type(self.lattice, Lattice, "lattice", "lfcal.state_lattice makes one of figures")
        if self.mosaic not in (None, *MOSAICS):
            raise ValueError(f"mosaic must be {', '.join(MOSAICS)} or None, got {self.mosaic!r}")
        if (
            self.white_level is not None
            and not 0 < check_number(self.white_level, "white_level") < np.inf
        ):
            raise ValueError(f"white_level must be positive or None, got {self.white_level!r}")

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of the flats this camera makes [px]."""
        return self.lattice.image_size

    @property
    def confidence_text(self) -> str:
        """The confidence in percent; at most 99.9 %, because no lattice that is found is certain."""
        most = self.confidence
        if self.source not in ("published", "truth"):
            most = min(most, _MOST_CONFIDENCE)
        rounded = f"{100 * most:.0f}"
        if rounded in ("0", "100") and most not in (0.0, 1.0):
            rounded = f"{100 * most:.1f}"
        return f"{rounded} %"

    def with_mosaic(
        self, mosaic: Mosaic | None, guessed: bool = False, flat: NDArray[Any] | None = None
    ) -> Calibration:
        """The camera with these colour filters, and a warning if they are guessed.

        If they are stated and a `flat` (h, w) is given, its green pixels must lie where they say:
        otherwise there is a FlatError.
        """
        if flat is not None and not guessed:
            from ..images.mosaic import check_mosaic

            check_mosaic(mosaic, flat)
        earlier = "look exchanged, name the filters"
        warnings = [text for text in self.warnings if earlier not in text]
        if guessed and mosaic is not None:
            other = mosaic.translate(str.maketrans("RB", "BR"))
            warning = (
                f"the flat is seen through colour filters, taken for {mosaic}: where green is was "
                f"measured, red and blue are a guess; if they look exchanged, name the filters "
                f"(--mosaic {other})"
            )
            if self.mosaic not in (None, mosaic):
                warning += f"; another flat of this camera was taken for {self.mosaic}"
            warnings.append(warning)
        balance = self.white_balance
        if balance is not None and mosaic != self.mosaic:
            balance = balance[::-1]
        return replace(
            self,
            mosaic=mosaic,
            mosaic_guessed=guessed,
            white_balance=balance,
            warnings=tuple(warnings),
        )

    def digest(self, flat: Array) -> str:
        """Digest of every 16th row of a flat, together with the places and types of the microlenses.

        Noise makes these rows differ from those of any other flat.
        """
        lattice = self.lattice
        rows = np.asarray(flat)[::16]
        arrays = {"flat": rows, "origin": lattice.origin, "basis": lattice.basis}
        if lattice.distortion is not None:
            arrays["distortion"] = np.array(json.dumps(lattice.distortion.to_dict()))
        if self.lens_types is not None:
            arrays["lens_types"] = self.lens_types.cell
        return digest_arrays(arrays)

    def is_own(self, flat: Array) -> bool:
        """Whether the camera was calibrated on this flat, is sure, and has its lattice still."""
        return bool(self.flats) and self.digest(flat) in self.flats

    def with_mosaic_of(self, flat: NDArray[Any]) -> Calibration:
        """The camera with the colour filters found on a flat (h, w), unless it has some."""
        from ..images.mosaic import find_mosaic

        known = self.mosaic is not None and not self.mosaic_guessed
        mosaic = None if known else find_mosaic(flat)
        return self if mosaic is None else self.with_mosaic(mosaic, guessed=True)

    def to_dict(self) -> dict[str, Any]:
        """The camera as plain numbers and strings, as written by `save`."""
        lattice = self.lattice
        vignetting = self.vignetting
        known: dict[str, Any] = {
            "origin": lattice.origin.tolist(),
            "basis": lattice.basis.tolist(),
            "radius": lattice.radius,
            "pitch": lattice.pitch,
        }
        if lattice.distortion is not None:
            known["distortion"] = lattice.distortion.to_dict()
        fit = {name: getattr(self, name) for name in _FIT}
        return {
            "schema": _SCHEMA,
            "version": _VERSION,
            "image_size": list(self.image_size),
            "lattice": known,
            "vignetting": vignetting
            and {"step": vignetting.step, "profile": vignetting.profile.tolist()},
            "fit": {name: None if np.isnan(value) else value for name, value in fit.items()},
            "warnings": list(self.warnings),
            **{name: getattr(self, name) for name in _VALUES},
            **{name: (part := getattr(self, name)) and part.to_dict() for name in _PARTS},
            "evidence": self.evidence and self.evidence.to_dict(),
        }

    @classmethod
    def from_dict(cls, data: Any) -> Calibration:
        """Rebuild a camera from `to_dict`; CameraFileError with the name of a wrong field."""
        if not isinstance(data, dict) or data.get("schema") != _SCHEMA:
            raise CameraFileError(f"not an {_SCHEMA} file; make one with 'lfcal calibrate IMAGE'")
        version = data.get("version")
        if version not in (_ROW_ORDER_VERSION, _VERSION):
            raise CameraFileError(f"version {version!r} is not known, 1 and 2 are; calibrate again")
        # The library that checks camera files is loaded only to read one.
        from .schema import check_together, read_fields

        known = read_fields(data)
        bend = None
        if known.lattice.distortion is not None:
            with _field_errors("lattice.distortion"):
                bend = Distortion.from_dict(data["lattice"]["distortion"])
        with _field_errors("lattice"):
            lattice = Lattice(
                known.lattice.origin,
                known.lattice.basis,
                known.image_size,
                known.lattice.radius,
                bend,
            )
        with _field_errors("vignetting"):
            light = known.vignetting and Vignetting(known.vignetting.profile, known.vignetting.step)
        values = {name: getattr(known, name) for name in (*_VALUES, "evidence")}
        fit = {name: getattr(known.fit, name) for name in _FIT}
        values |= {name: float("nan") if value is None else value for name, value in fit.items()}
        # Files of earlier versions do not have all of them.
        for name in (name for name in _PARTS if getattr(known, name) is not None):
            with _field_errors(name):
                values[name] = _PARTS[name].from_dict(data[name])
        if "gain_map" in values and version == _ROW_ORDER_VERSION:
            values["gain_map"] = _in_centre_order(values["gain_map"], lattice)
        camera = cls(lattice=lattice, vignetting=light, warnings=tuple(known.warnings), **values)
        check_together(lattice, known.lattice.pitch, camera.gain_map, light, camera.evidence)
        return camera

    def gain(self) -> NDArray[np.float32]:
        """(h, w) relative light of pixels, 1 at the brightest; NaN in gaps and unlit lenses."""
        return self.region_gain().at(0, 0, *self.image_size)

    def flatten(self, flat: ArrayLike) -> NDArray[Any]:
        """Divide a flat by the gain of the camera, so that a white image of it becomes even.

        `flat` (h, w) or (h, w, c), of unsigned integers or floats, keeps its type: integers are
        rounded and clipped. Pixels of unknown gain, NaN in `gain()`, do not change. FlatError if
        the flat has another size.
        """
        pixels = np.asarray(flat)
        if pixels.ndim not in (2, 3) or pixels.dtype.kind not in "uf" or 0 in pixels.shape:
            raise FlatError(
                f"flat of shape {pixels.shape} and type {pixels.dtype}; give a grey or colour "
                "picture"
            )
        if pixels.shape[1::-1] != self.image_size:
            given, own = (
                "{} x {} px".format(*size) for size in (pixels.shape[1::-1], self.image_size)
            )
            raise FlatError(
                f"flat is {given}, the camera is for {own}; calibrate on a flat of that size"
            )
        return self.region_gain().flatten(pixels)[0]

    def region_gain(self) -> RegionGain:
        """The gain of parts of a flat, for flats that are too large for `gain` and `flatten`."""
        return RegionGain(self._gain_map(), self.lattice)

    def usable_radius(self) -> NDArray[np.float64]:
        """(n,) radius [px] at which microimages have half their light, in the order of the centres.

        It is at most half the distance to the nearest microimage. If mechanical vignetting cuts a
        microimage, it is the distance to the cut; for unlit lenses it is 0.
        """
        return self._gain_map().usable_radius(self.lattice)

    def lit_reach(self) -> float:
        """Distance [px] from the centre of a microimage to its farthest point that is lit.

        It exceeds `lattice.radius` if microimages have the shape of their cells, as elemental images
        without gaps and square apertures have: there it is the distance to their corners.
        """
        radius = self.lattice.radius
        if self.gain_map is None and self.vignetting is None:
            return radius
        corner = Cell.of(self.lattice).circumradius
        return max(radius, self._gain_map().lit_cell(self.lattice) * corner)

    def plot(self, ax: Any = None) -> Any:
        """Draw the mean residuals over the flat, or the centres if residuals are not measured.

        The Matplotlib axes, by default the current ones, are returned.
        """
        import matplotlib.pyplot as plt

        from .plotting import plot_centres, plot_residuals

        ax = ax or plt.gca()
        if self.residuals is None:
            plot_centres(self.lattice, self.lens_types, ax)
            return ax
        arrows, longest = plot_residuals(self.lattice, self.residuals, ax)
        if arrows is not None:
            ax.figure.colorbar(arrows, ax=ax, label="length over its standard error")
        ax.set_title(f"Mean residuals of the lattice, at most {longest:.2g} px")
        return ax

    def __repr__(self) -> str:
        sure = (
            "" if self.source in ("published", "truth") else f", confidence {self.confidence:.2f}"
        )
        return f"Calibration({self.lattice!r}, source {self.source!r}{sure})"

    def _repr_html_(self) -> str:
        from .plotting import plot_centres

        shape, rows, turned = describe_orientation(self.lattice)
        width, height = self.image_size
        count = 1 if self.lens_types is None else self.lens_types.count
        figures = {
            "lattice": f"{shape}, rows {rows}, turned by {turned:+.4f}°",
            "pitch": f"{self.lattice.pitch:.4f} px",
            "usable radius": f"{self.lattice.radius:.2f} px",
            "flat": f"{width} x {height} px, {len(self.lattice)} lenses",
            "lens types": str(count),
            "measured on": f"{self.source}, confidence {self.confidence_text}",
        }
        if np.isfinite(self.residual_rms):
            figures["residual"] = f"{self.residual_rms:.3f} px RMS of {self.lenses_used} lenses"
        return html_card(
            "Calibration",
            figures,
            lambda ax: plot_centres(self.lattice, self.lens_types, ax, most=40),
            self.warnings,
        )

    def _gain_map(self) -> GainMap:
        if self.gain_map is not None:
            return self.gain_map
        if self.vignetting is None:
            raise CalibrationError(
                "the camera file holds no gain map; make one with 'lfcal calibrate IMAGE'"
            )
        light = np.minimum(self.vignetting.profile, 1)
        return GainMap.round(light, self.vignetting.step, self.lattice.radius)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the camera as JSON; the file appears whole or not at all."""
        with atomic_write(path) as temporary:
            temporary.write_text(self.to_json(), encoding="utf-8")

    def to_json(self) -> str:
        """The text of the camera file that `save` writes."""
        return json.dumps(self.to_dict(), indent=2) + "\n"


@contextmanager
def _field_errors(name: str) -> Iterator[None]:
    """Turn errors of a field into a CameraFileError with the name of the field."""
    try:
        yield
    except KeyError as error:
        raise CameraFileError(f"field {name}: {error} is missing; calibrate again") from error
    except (TypeError, ValueError, AttributeError, ArithmeticError) as error:
        raise CameraFileError(f"field {name}: {error}; calibrate again") from error


def _in_centre_order(gain: GainMap, lattice: Lattice) -> GainMap:
    """A gain map with lenses in the order of the centres instead of in rows of `j`."""
    if len(gain.lens_gain) != len(lattice):
        return gain
    own = np.empty_like(gain.lens_gain)
    own[np.lexsort(lattice.indices().T)] = gain.lens_gain
    return replace(gain, lens_gain=own)
