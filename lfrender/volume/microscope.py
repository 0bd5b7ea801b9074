"""The optics of a light-field microscope: slopes k of rays from depths, micrometres from pixels."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from lfcal.runtime.errors import check_number

__all__ = ["Microscope", "Scale"]

# Full width at half maximum of the image of a point behind a square aperture [wavelength * focal
# length / side].
_DIFFRACTION_WIDTH = 0.886


@dataclass(frozen=True)
class Scale:
    """What reconstruction needs of the optics, in pixels of the flat.

    Without optics, `slope_per_depth` is 1 (depth is `k = -D / s` itself), `pixel` is 1 and
    `flat_radius` infinite.
    """

    slope_per_depth: float  # k of a plane at depth 1 [1 / um]
    pixel: float  # side of a pixel of the flat, seen through the objective [um]
    flat_radius: float  # radius of a microimage at which rays would lie flat: rho [px]
    pupil_radius: float  # of the rim of the aperture in a microimage [px]; infinite if not known
    diffraction: float  # width of the image of a point behind a microlens [px]
    unit: str  # of depth and of `pixel`: "um", or "px" without optics


@dataclass(frozen=True)
class Microscope:
    """Figures of a light-field microscope, as its owners know them; what is None is not known.

    With `na` and `magnification`, and one of `pixel_size` and `microlens_focal_length`, volumes are
    in micrometres, and rays obey the sine condition of Abbe, which matters above an NA of about
    0.5. All else is a refinement.

    Parameters
    ----------
    na : float, optional
        Numerical aperture of the objective.
    magnification : float, optional
        Of the objective with its tube lens and relay lenses, from the specimen to the microlenses.
    medium_index : float
        Refractive index of the medium of the specimen: 1.33 for water.
    microlens_focal_length : float, optional [um]
    pixel_size : float, optional [um]
        Side of a pixel of the sensor, as the microlenses see it: divided by the magnification of a
        relay lens between them.
    wavelength : float, optional [nm]
        For the blur of diffraction.

    Examples
    --------
    >>> from lfrender.volume.microscope import Microscope
    >>> figures = {"na": 1.2, "magnification": 60, "medium_index": 1.35}
    >>> water = Microscope(**figures, microlens_focal_length=2500, pixel_size=6.5)
    >>> scale = water.scale(radius=7.5, pitch=15.4)
    >>> round(scale.flat_radius, 2), round(1 / scale.slope_per_depth, 3)  # px; um of a slope of 1
    (8.65, 0.938)
    """

    na: float | None = None
    magnification: float | None = None
    medium_index: float = 1.33
    microlens_focal_length: float | None = None
    pixel_size: float | None = None
    wavelength: float | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None and not 0 < check_number(value, field.name) < np.inf:
                raise ValueError(f"{field.name} must be a positive number, got {value!r}")
        if self.na is not None and self.na >= self.medium_index:
            raise ValueError(
                f"na must be less than medium_index ({self.medium_index:g}), got {self.na:g}; "
                "an objective cannot take in rays beyond 90 degrees"
            )

    @property
    def metric(self) -> bool:
        """Whether volumes can be in micrometres."""
        known = self.pixel_size is not None or self.microlens_focal_length is not None
        return known and self.na is not None and self.magnification is not None

    def missing(self) -> str:
        """What has to be given for volumes in micrometres; empty if all is known."""
        needed = [name for name in ("na", "magnification") if getattr(self, name) is None]
        if self.pixel_size is None and self.microlens_focal_length is None:
            needed.append("pixel_size or microlens_focal_length")
        return ", ".join(needed)

    def scale(self, radius: float, pitch: float) -> Scale:
        """The optics in pixels, for microimages of a measured `radius` [px] and a `pitch` [px]."""
        flat_radius = np.inf if self.na is None else radius * self.medium_index / self.na
        if not self.metric:
            return Scale(1.0, 1.0, flat_radius, np.inf, 0.0, "px")
        assert self.na is not None and self.magnification is not None
        focal = self.microlens_focal_length
        pixel = self.pixel_size
        pupil = radius
        diffraction = 0.0
        if pixel is None:
            assert focal is not None
            pixel = focal * self.na / (self.magnification * radius)
        if focal is not None:
            pupil = focal * self.na / (self.magnification * pixel)
            flat_radius = pupil * self.medium_index / self.na
        if focal is not None and self.wavelength is not None:
            lens = pitch * pixel
            diffraction = _DIFFRACTION_WIDTH * 1e-3 * self.wavelength * focal / lens / pixel
        seen = pixel / self.magnification
        # At a depth z a ray of sine |delta| / rho lies z tan(angle) aside: k / rho = z / seen.
        return Scale(1.0 / (seen * flat_radius), seen, flat_radius, pupil, diffraction, "um")
