"""Views as pictures of pinhole cameras in the aperture of the main lens: intrinsics, positions, and depth.

A view reads the flat at `Y = X + q D / s` (docs/geometry.md), so that its parallax is linear in the virtual depth
`D / s`, as is that of pinhole cameras in `1 / Z`. With the optics known, positions and depth are metric; without, the
focal length is chosen, the baseline between neighbouring views is 1, and the scene is right up to a projective
transformation that leaves all views as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal import Calibration, Optics

from ..data.depth_map import DepthMap
from ..rendering.warped_surface import virtual_depth

__all__ = ["ViewCamera", "ViewRig", "view_rig"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ViewCamera:
    """A pinhole camera; its axes are x right, y down, z forward, those of all cameras of a rig.

    Examples
    --------
    >>> import numpy
    >>> camera = ViewCamera(numpy.zeros(3), (100.0, 100.0), (50.0, 40.0), (101, 81))
    >>> camera.project([[0.1, 0.0, 1.0]])
    array([[60., 40.]])
    """

    position: Array  # (3,) in the unit of the rig
    focal: tuple[float, float]  # [px]
    principal_point: tuple[float, float]  # [px], pixel centres at integers
    size: tuple[int, int]  # width and height [px]
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # k1, k2, p1, p2 as OpenCV has them

    def project(self, points: ArrayLike) -> Array:
        """(n, 2) pixels `u, v` at which points (n, 3) are seen."""
        import cv2

        matrix = np.diag([*self.focal, 1.0])
        matrix[:2, 2] = self.principal_point
        places = np.asarray(points, dtype=np.float64).reshape(-1, 1, 3) - self.position
        found = cv2.projectPoints(places, np.zeros(3), np.zeros(3), matrix, np.array(self.distortion))[0]
        return np.asarray(found.reshape(-1, 2))


@dataclass(frozen=True)
class ViewRig:
    """The cameras of several views of one scene.

    Examples
    --------
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> picture = lfrender.render(flat, camera, depth, scale=6)
    >>> rig = view_rig(camera, depth, [(-4.0, 0.0), (4.0, 0.0)], picture.affine, (62, 47), still=-7.0)
    >>> len(rig.cameras), rig.unit
    (2, 'baseline')
    """

    cameras: tuple[ViewCamera, ...]
    unit: str  # "m", or "baseline" of neighbouring views
    error: float = 0.0  # RMS distance of what the cameras project from what the optics do [px]
    _pitch: float = field(default=1.0, repr=False)
    _offsets: Array = field(default_factory=lambda: np.zeros((0, 2)), repr=False)
    _optics: Optics | None = field(default=None, repr=False)
    _middle: Array = field(default_factory=lambda: np.zeros(2), repr=False)
    # Without optics, 1 / Z = (far - D / s) * slope.
    _far: float = field(default=0.0, repr=False)
    _slope: float = field(default=1.0, repr=False)

    def depth(self, view: int, patch_size: NDArray[Any], places: Array) -> NDArray[np.float32]:
        """(h, w) float32: distance along the axis, in the unit of the rig, of what view number `view` shows.

        `patch_size` (h, w) [px] is drawn at `places` (h, w, 2) [px] on the microlens plane, `Y`. It is inf at infinity,
        NaN where the optics can image nothing.
        """
        virtual = virtual_depth(np.asarray(patch_size, np.float32), self._pitch).astype(np.float64)
        if self._optics is None:
            vergence = (self._far - virtual) * self._slope
            with np.errstate(divide="ignore"):
                return np.where(vergence > 0, 1 / vergence, np.inf).astype(np.float32)
        scene = places - self._offsets[view] * virtual[..., None]
        found = self._optics.positions(scene.reshape(-1, 2), (1 / virtual).ravel(), self._middle)[:, 2]
        return (found - self.cameras[view].position[2]).reshape(virtual.shape).astype(np.float32)


def view_rig(
    calibration: Calibration,
    depth: DepthMap,
    offsets: Sequence[tuple[float, float]],
    affine: Array,
    size: tuple[int, int],
    still: float,
    optics: Optics | None = None,
) -> ViewRig:
    """The cameras of the views that `lfrender.views` draws for these `offsets` [px] and `still` [px].

    All views have the `affine` from pixel to scene coordinates, and the width and height `size` [px]. The optics are
    those of the calibration if no others are given.

    Examples
    --------
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> picture = lfrender.render(flat, camera, depth, scale=6)
    >>> view_rig(camera, depth, [(-4.0, 0.0)], picture.affine, (62, 47), still=-7.0).cameras[0].size
    (62, 47)
    """
    lattice = calibration.lattice
    optics = optics or calibration.optics
    middle = (np.array(lattice.image_size) - 1) / 2
    where = np.array(offsets, dtype=float).reshape(-1, 2)
    step, moved = np.diag(affine), where * (lattice.pitch / still)
    virtual = virtual_depth(depth.surface.patch_size, depth.pitch)

    def cameras(aside: Array, focal: float, centres: Array) -> tuple[ViewCamera, ...]:
        """Cameras at places `aside` (n, 2), with focal length and principal points (n, 2) on the microlens plane."""
        return tuple(
            ViewCamera(np.array([*place, 0.0]), (focal / step[0], focal / step[1]), (x, y), size)
            for place, (x, y) in zip(aside, ((centres - moved - affine[:, 2]) / step).tolist(), strict=True)
        )

    if optics is None:
        # In units of the baseline: the focal length is the longer side, infinity a little behind the scene, where
        # `D / s = beyond` is drawn at X + q beyond.
        near, far = (float(v) for v in np.quantile(virtual, (0.01, 0.99)))
        beyond, focal = far + 0.25 * max(far - near, 0.1), float(max(depth.image_size))
        gaps = np.linalg.norm(where[:, None] - where, axis=-1)
        unit = float(gaps[gaps > 0].min()) if (gaps > 0).any() else 1.0
        made = cameras(where / unit, focal, middle + where * beyond)
        return ViewRig(made, "baseline", 0.0, depth.pitch, where, None, middle, beyond, unit / focal)
    axis = np.array(optics.principal_point) if optics.principal_point is not None else middle
    far = optics.mla_distance
    spread = 1 + optics.sensor_distance / far
    # The lens at c is read at c + q: the ray crosses the main lens there.
    aside = where * optics.pixel * far / optics.sensor_distance
    centres = axis - spread / optics.pixel * aside * (1 - far / optics.focal_length)
    made = cameras(aside * 1e-3, spread * far / optics.pixel, centres)
    rig = ViewRig(made, "m", 0.0, lattice.pitch, where, optics, middle)
    if not any((*optics.radial, *optics.tangential, *optics.tilt, optics.curvature, optics.pupil)):
        return rig
    # Optics with distortion, tilt, curvature or a pupil: the cameras that come nearest.
    sides = [np.linspace(0.02, 0.98, 9) * side for side in depth.image_size]
    x, y, v = (axis.ravel() for axis in np.meshgrid(*sides, np.quantile(virtual, (0.02, 0.5, 0.98))))
    scene = np.column_stack([x, y])
    points = optics.positions(scene, 1 / v.astype(np.float64), middle)
    known = np.isfinite(points).all(1)
    drawn = [(scene + q * v[:, None] - own - affine[:, 2]) / step for q, own in zip(where, moved, strict=True)]
    fitted = [_fit(one, points[known], at[known]) for one, at in zip(made, drawn, strict=True)]
    error = float(np.sqrt(np.mean([square for _, square in fitted])))
    return replace(rig, cameras=tuple(camera for camera, _ in fitted), error=error)


def _fit(camera: ViewCamera, points: Array, pixels: Array) -> tuple[ViewCamera, float]:
    """The camera that projects points (n, 3) most nearly to pixels (n, 2), and the mean squared distance."""
    from scipy.optimize import least_squares

    def changed(step: Array) -> ViewCamera:
        (fx, fy), (x, y) = camera.focal, camera.principal_point
        return replace(
            camera, position=camera.position + step[:3], focal=(fx * (1 + step[3]), fy * (1 + step[3])),
            principal_point=(x + step[4], y + step[5]), distortion=tuple(step[6:].tolist()),
        )  # fmt: skip

    found = least_squares(lambda step: np.ravel(changed(step).project(points) - pixels), np.zeros(10), x_scale="jac")
    return changed(found.x), float(np.mean(found.fun**2)) * 2
