"""The simulated camera: a thin main lens, an array of thin microlenses with opaque gaps, and a
sensor.

All lengths on the optical axis are in mm, everything on the sensor in flat pixels. Object space is
turned by 180 degrees about the axis, so that what lies to the right on the flat has a larger `x`
out there: a pinhole at the main-lens centre then shows the scene upright.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal import Calibration, Lattice
from lfcal.gain.gain_map import Vignetting
from lfcal.runtime.image_formats import Mosaic

__all__ = ["LATTICES", "Camera"]

LATTICES: dict[str, tuple[tuple[float, float], tuple[float, float]]] = {
    "hex": ((1.0, 0.0), (0.5, 0.75**0.5)),
    "hex-vertical": ((0.0, 1.0), (-(0.75**0.5), 0.5)),
    "square": ((1.0, 0.0), (0.0, 1.0)),
    "rectangular": ((1.0, 0.0), (0.0, 1.15)),
    "sheared": ((1.0, 0.0), (0.25, 1.0)),
}

# Proportions of `Camera.design`, those of common focused plenoptic cameras: f/4, and room behind
# the main lens for real image planes on both sides of the microlenses.
_SENSOR_DISTANCE = 3.92
_IMAGE_ROOM = 16.0


@dataclass(frozen=True)
class Camera:
    """A focused plenoptic camera (Lumsdaine and Georgiev 2008, sections 3 and 4).

    Parameters
    ----------
    width, height : int [px]
        Size of the flat.
    pixel : float [mm]
        Pitch of the sensor pixels.
    focal_length : float [mm]
        Main lens.
    mla_distance : float [mm]
        `dL`, main lens to microlenses.
    sensor_distance : float [mm]
        `b`, microlenses to sensor.
    microlens_focal_lengths : tuple of 1 to 3 floats [mm]
        One for each lens type; of n types, lens `(i, j)` has number `(i - j) mod n` (in a hexagonal
        array of three and in a square one of two no two neighbours are alike).
    aperture : float [mm]
        Diameter of the main lens, or the side of its square aperture.
    fill : float
        Diameter of a microlens over the microlens pitch; the rest is opaque. It sets the microlens
        defocus.
    basis : 2 x 2 floats [px]
        Rows span the lattice of microimage centres; stored in shortest form with an angle of 60 to
        90 degrees.
    origin : (float, float) [px]
        Centre of microimage (0, 0).
    principal_point : (float, float) [px]
        Where the optical axis meets the flat.
    natural_vignetting : bool
        Weigh the light of a microlens by cos^4 of the angle of its chief ray on the sensor.
    square_aperture : bool
        Whether the aperture of the main lens, and so each microimage, is a square along the first
        lattice direction.
    type_apertures : tuple of 1 to 3 floats
        Share of the aperture that a lens of each type lets pass: the radii of its microimages.
    stray : float
        Share of the light that comes past the microlenses, spread evenly over a pitch: gaps are not
        black.
    mosaic : {"RGGB", "BGGR", "GRBG", "GBRG"} or None
        Colour filters over the top left 2 x 2 pixels; flat and white image are then (H, W).
    filters : (float, float, float)
        Brightness of white seen through the red, green and blue filter.
    stop : (float, float) or None [mm]
        Distance in front of the main lens and diameter of a fixed stop: mechanical vignetting,
        which cuts microimages to cat's eyes away from the principal point.
    k1 : float
        Radial distortion of the main lens: a ray that leaves it with slope `S` undistorted leaves
        with `S (1 + k1 |S|^2)`.
    tilt : (float, float) [rad]
        Of microlens array and sensor together: with a positive first angle the lower part of the
        flat lies farther from the main lens, with a positive second angle its right part nearer.
        Cameras with distortion or tilt can photograph boards (`shoot_board`); `simulate` knows the
        truth of straight ones only.
    sensor_tilt : (float, float) [rad]
        Of the sensor against the array: towards the right and towards the bottom of the flat the
        distance between them grows by the tangent, about `sensor_distance` at the principal point.
        `lattice` is that without it.

    Examples
    --------
    >>> from data_synth import SCENES, Camera, simulate
    >>> camera = Camera.design(size=(120, 90), pitch=20)
    >>> round(camera.pitch, 3), camera.lattice.image_size
    (20.0, (120, 90))
    """

    width: int
    height: int
    pixel: float
    focal_length: float
    mla_distance: float
    sensor_distance: float
    microlens_focal_lengths: tuple[float, ...]
    aperture: float
    fill: float
    basis: tuple[tuple[float, float], tuple[float, float]]
    origin: tuple[float, float]
    principal_point: tuple[float, float]
    natural_vignetting: bool = True
    square_aperture: bool = False
    type_apertures: tuple[float, ...] = (1.0,)
    stray: float = 0.0
    mosaic: Mosaic | None = None
    filters: tuple[float, float, float] = (1.0, 1.0, 1.0)
    stop: tuple[float, float] | None = None
    k1: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    sensor_tilt: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not (1 <= self.width <= 1 << 15 and 1 <= self.height <= 1 << 15):
            raise ValueError(
                f"width and height must be 1 to {1 << 15} px, got {self.width} x {self.height}"
            )
        lengths = ("pixel", "focal_length", "mla_distance", "sensor_distance", "aperture", "fill")
        for name in lengths:
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be a positive number, got {value!r}")
            object.__setattr__(self, name, float(value))
        if self.fill > 1:
            raise ValueError(f"fill must be at most 1 (touching microlenses), got {self.fill}")
        focal = tuple(float(f) for f in self.microlens_focal_lengths)
        if len(focal) not in (1, 2, 3) or not all(np.isfinite(f) and f > 0 for f in focal):
            raise ValueError(
                f"microlens_focal_lengths must be 1 to 3 positive numbers, got {focal}"
            )
        for name, low in (("type_apertures", 0.1), ("filters", 0.01), ("stray", 0.0)):
            values = np.array(getattr(self, name), dtype=float)
            if not ((values >= low) & (values <= 1)).all():
                raise ValueError(f"{name} must lie between {low} and 1, got {getattr(self, name)}")
        if len(self.type_apertures) not in (1, len(focal)) or len(self.filters) != 3:
            raise ValueError(
                "type_apertures takes one number, or one for each of microlens_focal_lengths, "
                "filters three"
            )
        if self.mosaic not in (None, "RGGB", "BGGR", "GRBG", "GBRG"):
            raise ValueError(f"mosaic must be RGGB, BGGR, GRBG or GBRG, got {self.mosaic!r}")
        for name in ("type_apertures", "filters"):
            object.__setattr__(self, name, tuple(float(value) for value in getattr(self, name)))
        if self.stop is not None and not (
            len(self.stop) == 2 and min(self.stop) > 0 and np.isfinite(self.stop).all()
        ):
            raise ValueError(f"stop must be (distance, diameter), both positive, got {self.stop}")
        points = [tuple(float(v) for v in point) for point in (self.origin, self.principal_point)]
        if any(len(point) != 2 or not np.isfinite(point).all() for point in points):
            raise ValueError("origin and principal_point must be two finite numbers each")
        tilts = (*self.tilt, *self.sensor_tilt)
        if not np.isfinite([self.k1, *tilts]).all() or max(map(abs, tilts)) > 0.1:
            raise ValueError(
                f"k1 and tilts must be finite, tilts at most 0.1 rad, got {self.k1} and {tilts}"
            )
        for name in ("tilt", "sensor_tilt"):
            object.__setattr__(self, name, tuple(map(float, getattr(self, name))))
        object.__setattr__(self, "microlens_focal_lengths", focal)
        object.__setattr__(self, "basis", _shortest_acute(self.basis))
        object.__setattr__(self, "origin", points[0])
        object.__setattr__(self, "principal_point", points[1])
        # A microimage wider than its neighbours' distance would light a pixel through lenses the
        # tracer does not try.
        if self.microimage_radius > self._shortest_step:
            raise ValueError(
                "aperture is too wide: microimages overlap by more than half; make the aperture "
                "smaller"
            )

    @classmethod
    def design(
        cls,
        size: tuple[int, int] = (1100, 1100),
        pitch: float = 23.2,
        lattice: str | ArrayLike = "hex",
        rotation: float = 0.0,
        *,
        focus: float | tuple[float, ...] = 0.04,
        fill: float = 0.28,
        microimage_fill: float = 0.97,
        pixel: float = 0.0055,
        focal_length: float = 50.0,
        offset: tuple[float, float] = (0.37, -0.81),
        natural_vignetting: bool = True,
    ) -> Camera:
        """A well-proportioned camera from the figures one cares about: size, pitch, lattice and
        rotation.

        Parameters
        ----------
        size : (int, int) [px]
            Width and height of the flat.
        pitch : float [px]
            `D`, mean distance between neighbouring microimage centres.
        lattice : str or (2, 2) array_like
            One of `LATTICES`, or any two vectors, scaled to `pitch`.
        rotation : float [degrees]
            Clockwise on the screen.
        focus : float or up to three floats
            `s / D` that the microlenses are focused at; several values make interleaved lens types.
        microimage_fill : float
            Width of a microimage over the distance of neighbouring centres; the rest is dark.
        offset : (float, float) [px]
            From the middle of the flat to microimage (0, 0).

        Examples
        --------
        >>> camera = Camera.design(size=(300, 200), pitch=20, lattice="square", rotation=3)
        >>> round(camera.pitch, 6), round(camera.microimage_radius, 2)
        (20.0, 9.7)
        """
        width, height = (int(v) for v in size)
        if not (np.isfinite(pitch) and pitch >= 2):
            raise ValueError(f"pitch must be at least 2 px, got {pitch!r}")
        if isinstance(lattice, str) and lattice not in LATTICES:
            raise ValueError(f"lattice must be one of {', '.join(LATTICES)}, got {lattice!r}")
        angle = np.deg2rad(float(rotation))
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        shape = np.array(LATTICES[lattice] if isinstance(lattice, str) else lattice, dtype=float)
        middle = ((width - 1) / 2, (height - 1) / 2)
        unit = Lattice(np.zeros(2), np.array(_shortest_acute(shape)), (1, 1), 1.0).pitch
        b = _SENSOR_DISTANCE * pitch * pixel
        distance = focal_length + _IMAGE_ROOM * b
        ratios = np.atleast_1d(np.array(focus, dtype=float))
        # 1/f = 1/a + 1/b, with the image-plane distance `a` that has s / D = focus.
        focal = 1 / ((ratios * (1 + b / distance) / b + 1 / distance) + 1 / b)
        basis = np.array(_shortest_acute(shape / unit * pitch @ turn))
        spacing = np.linalg.norm(basis, axis=1).min()
        return cls(
            width=width,
            height=height,
            pixel=pixel,
            focal_length=focal_length,
            mla_distance=distance,
            sensor_distance=b,
            microlens_focal_lengths=tuple(focal.tolist()),
            aperture=microimage_fill * spacing * pixel * distance / b,
            fill=fill,
            basis=_shortest_acute(basis),
            origin=(middle[0] + offset[0], middle[1] + offset[1]),
            principal_point=middle,
            natural_vignetting=natural_vignetting,
        )

    def replace(self, **changes: Any) -> Camera:
        """The same camera with some fields changed."""
        return replace(self, **changes)

    @property
    def straight(self) -> bool:
        """Whether the main lens has no distortion, and neither array nor sensor a tilt."""
        return self.k1 == 0 and not any((*self.tilt, *self.sensor_tilt))

    @cached_property
    def array_axes(self) -> NDArray[np.float64]:
        """(3, 3) axes of the array, as columns, in the frame of the main lens; the third points to
        the lens.
        """
        (cx, sx), (cy, sy) = ((np.cos(angle), -np.sin(angle)) for angle in self.tilt)
        return np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]]) @ np.array(
            [[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]]
        )

    @property
    def spread(self) -> float:
        """`1 + b / dL`: microimage centres are this much farther apart than the microlenses."""
        return 1 + self.sensor_distance / (self.mla_distance * float(self.array_axes[2, 2]))

    @cached_property
    def lattice(self) -> Lattice:
        """Where the chief rays (main-lens centre through microlens centre) meet the sensor; radius
        of a microimage.
        """
        radius = min(self.microimage_radius, self._shortest_step / 2)
        return Lattice(
            np.array(self.origin), np.array(self.basis), (self.width, self.height), radius
        )

    @property
    def pitch(self) -> float:
        """D: mean distance between neighbouring microimage centres [px]."""
        return self.lattice.pitch

    @property
    def microlens_pitch(self) -> float:
        """Mean distance between neighbouring microlenses [mm]."""
        return self.pitch * self.pixel / self.spread

    @property
    def microimage_radius(self) -> float:
        """Radius of the main aperture (half the side of a square one) seen through one microlens
        centre [px].
        """
        return self.aperture / 2 * self.sensor_distance / self.mla_distance / self.pixel

    @property
    def _shortest_step(self) -> float:
        return float(np.linalg.norm(self.basis, axis=1).min())

    def lens_types(self, index: NDArray[np.int64]) -> NDArray[np.int64]:
        """(n,) numbers of the lens types at lattice indices (n, 2)."""
        return (index[:, 0] - index[:, 1]) % len(self.microlens_focal_lengths)

    def half_apertures(self, types: ArrayLike) -> NDArray[np.float64]:
        """Half of the aperture [mm] that lenses of the given types let pass."""
        shares = np.broadcast_to(self.type_apertures, len(self.microlens_focal_lengths))
        return shares[np.asarray(types)] * (self.aperture / 2)

    def calibration(self, vignetting: Vignetting | None = None) -> Calibration:
        """The true calibration of this camera."""
        return Calibration(
            self.lattice,
            vignetting,
            source="truth",
            residual_rms=0.0,
            lenses_used=len(self.lattice),
            confidence=1.0,
            mosaic=self.mosaic,
        )

    def patch_size(self, depth: ArrayLike) -> NDArray[np.float64]:
        """Signed patch size `s` [px] of places at `depth` [mm] in front of the main lens, NaN for
        NaN.

        The closed form behind it is `s = p * b * (1 / a - 1 / dL) / pixel`, where the main lens
        images the depth to a plane at `a` in front of the microlenses.
        """
        with np.errstate(divide="ignore"):
            image = 1 / (1 / self.focal_length - 1 / np.asarray(depth, dtype=np.float64))
            vergence = 1 / (self.mla_distance - image) - 1 / self.mla_distance
        return self.microlens_pitch * self.sensor_distance * vergence / self.pixel

    def depth_at(self, ratio: ArrayLike) -> NDArray[np.float64]:
        """Depth [mm] in front of the main lens where `s / D` is `ratio`; ValueError where no object
        can lie there.
        """
        ratio = np.asarray(ratio, dtype=np.float64)
        if not np.isfinite(ratio).all():
            raise ValueError(f"s/D must be finite, got {ratio}")
        with np.errstate(divide="ignore"):
            in_front = 1 / (ratio * self.spread / self.sensor_distance + 1 / self.mla_distance)
            image = self.mla_distance - in_front
            depth = 1 / (1 / self.focal_length - 1 / image)
        if not ((image > self.focal_length) & np.isfinite(depth)).all():
            limit = self.sensor_distance * (
                1 / (self.mla_distance - self.focal_length) - 1 / self.mla_distance
            )
            raise ValueError(
                f"no object is seen at s/D = {ratio}; telescopic places need "
                f"s/D > {limit / self.spread:.3f}, binocular ones "
                f"s/D < {-self.sensor_distance / self.mla_distance / self.spread:.3f}"
            )
        return depth

    def place(self, points: ArrayLike, depth: ArrayLike) -> NDArray[np.float64]:
        """(..., 3) object-space positions [mm] of scene coordinates `points` (..., 2) [px] at
        `depth` (...) [mm].
        """
        on_lenses = (
            (np.asarray(points, dtype=np.float64) - self.principal_point) * self.pixel / self.spread
        )
        tangent_x, tangent_y = np.moveaxis(on_lenses / self.mla_distance, -1, 0)
        z = np.broadcast_to(np.asarray(depth, dtype=np.float64), tangent_x.shape)
        return np.stack([tangent_x * z, tangent_y * z, z], axis=-1)


def _shortest_acute(basis: Any) -> tuple[tuple[float, float], tuple[float, float]]:
    """The lattice's shortest basis with an angle of 60 to 90 degrees; a basis that has it already
    is kept.
    """
    a, b = np.array(basis, dtype=np.float64).reshape(2, 2)
    if not np.isfinite([a, b]).all() or abs(a[0] * b[1] - a[1] * b[0]) <= 1e-9 * (a @ a + b @ b):
        raise ValueError(
            f"basis must be two independent finite vectors, got {np.asarray(basis).tolist()}"
        )
    while abs(2 * (a @ b)) > min(a @ a, b @ b) * (1 + 1e-9):
        if a @ a > b @ b:
            a, b = b, a
        b = b - np.round((a @ b) / (a @ a)) * a
    if a @ b < -1e-9 * (a @ a):
        b = -b
    return (float(a[0]), float(a[1])), (float(b[0]), float(b[1]))
