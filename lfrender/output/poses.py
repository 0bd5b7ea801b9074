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
from ..data.viewpoint import virtual_depth

__all__ = ["ViewCamera", "ViewRig", "view_rig"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ViewCamera:
    """A pinhole camera; its axes are x right, y down, z forward, those of all cameras of a rig.

    Parameters
    ----------
    position : (3,) float64
        In the unit of the rig.
    focal : (float, float) [px]
    principal_point : (float, float) [px]
        Pixel centres at integers.
    size : (int, int) [px]
        Width and height.
    distortion : (k1, k2, p1, p2)
        As OpenCV has it.

    Examples
    --------
    >>> import numpy
    >>> camera = ViewCamera(numpy.zeros(3), (100.0, 100.0), (50.0, 40.0), (101, 81))
    >>> camera.project([[0.1, 0.0, 1.0]])
    array([[60., 40.]])
    """

    position: Array
    focal: tuple[float, float]
    principal_point: tuple[float, float]
    size: tuple[int, int]
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    def project(self, points: ArrayLike) -> Array:
        """(n, 2) pixels `u, v` at which points (n, 3) are seen."""
        x, y, z = (np.asarray(points, dtype=np.float64).reshape(-1, 3) - self.position).T
        x, y = x / z, y / z
        k1, k2, p1, p2 = self.distortion
        square = x * x + y * y
        gain = 1 + square * (k1 + square * k2)
        across = x * gain + 2 * p1 * x * y + p2 * (square + 2 * x * x)
        down = y * gain + p1 * (square + 2 * y * y) + 2 * p2 * x * y
        return np.column_stack([across, down]) * self.focal + self.principal_point


@dataclass(frozen=True)
class ViewRig:
    """The cameras of several views of one scene.

    Parameters
    ----------
    cameras : tuple of ViewCamera
    unit : str
        `"m"`, or `"baseline"` of neighbouring views.
    error : float [px]
        RMS distance of what the cameras project from what the optics do; 0 where it is exact.

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
    unit: str
    error: float = 0.0
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
    """The cameras of the views that `lfrender.views` draws.

    Parameters
    ----------
    calibration : Calibration
        Its optics are used if no others are given.
    depth : DepthMap
    offsets : sequence of (float, float) [px]
        As for `views`.
    affine, size
        Of all views: from pixel to scene coordinates, width and height [px].
    still : float [px]
        As for `views`.
    optics : Optics, optional

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
    grid = _Grid(np.asarray(affine, float), where * (lattice.pitch / still), size)
    if optics is None:
        return _chosen_rig(depth, where, grid, middle)
    axis = np.array(optics.principal_point) if optics.principal_point is not None else middle
    far = optics.mla_distance
    spread = 1 + optics.sensor_distance / far
    # The lens at c is read at c + q: the ray crosses the main lens there.
    aside = where * optics.pixel * far / optics.sensor_distance
    centres = axis - spread / optics.pixel * aside * (1 - far / optics.focal_length)
    cameras = grid.cameras(aside * 1e-3, spread * far / optics.pixel, centres)
    rig = ViewRig(cameras, "m", 0.0, lattice.pitch, where, optics, middle)
    bent = (*optics.radial, *optics.tangential, *optics.tilt, optics.curvature, optics.pupil)
    return _fitted(rig, depth, grid) if any(bent) else rig


@dataclass(frozen=True)
class _Grid:
    """The pixels of all views: from pixel to scene coordinates, how far each view is moved there, width and height."""

    affine: Array
    moved: Array  # (n, 2) [px]
    size: tuple[int, int]

    def pixels(self, view: int, places: Array) -> Array:
        """(n, 2) pixels of a view that show places (n, 2) on the microlens plane."""
        return (places - self.moved[view] - self.affine[:, 2]) / np.diag(self.affine)

    def cameras(self, aside: Array, focal: float, centres: Array) -> tuple[ViewCamera, ...]:
        """Cameras at places `aside` (n, 2), with focal length and principal points (n, 2) on the microlens plane."""
        across, down = np.diag(self.affine).tolist()
        made = []
        for view, (place, centre) in enumerate(zip(aside, centres, strict=True)):
            x, y = self.pixels(view, centre).tolist()
            made.append(ViewCamera(np.array([*place, 0.0]), (focal / across, focal / down), (x, y), self.size))
        return tuple(made)


def _chosen_rig(depth: DepthMap, offsets: Array, grid: _Grid, middle: Array) -> ViewRig:
    """Cameras in units of the baseline: the focal length is the longer side, infinity a little behind the scene."""
    virtual = virtual_depth(depth.surface.patch_size, depth.pitch)
    near, far = (float(v) for v in np.quantile(virtual, (0.01, 0.99)))
    beyond = far + 0.25 * max(far - near, 0.1)
    focal = float(max(depth.image_size))
    gaps = np.linalg.norm(offsets[:, None] - offsets, axis=-1)
    unit = float(gaps[gaps > 0].min(initial=np.inf))
    unit = unit if np.isfinite(unit) else 1.0
    # A point at infinity, `D / s = beyond`, is drawn at X + q beyond.
    cameras = grid.cameras(offsets / unit, focal, middle + offsets * beyond)
    return ViewRig(cameras, "baseline", 0.0, depth.pitch, offsets, None, middle, beyond, unit / focal)


def _fitted(rig: ViewRig, depth: DepthMap, grid: _Grid) -> ViewRig:
    """The rig with cameras that come nearest to optics with distortion, tilt, curvature or a pupil."""
    from scipy.optimize import least_squares

    assert rig._optics is not None
    virtual = virtual_depth(depth.surface.patch_size, depth.pitch)
    sides = [np.linspace(0.02, 0.98, 9) * side for side in depth.image_size]
    x, y, v = (axis.ravel() for axis in np.meshgrid(*sides, np.quantile(virtual, (0.02, 0.5, 0.98))))
    scene = np.column_stack([x, y])
    points = rig._optics.positions(scene, 1 / v.astype(np.float64), rig._middle)
    known = np.isfinite(points).all(1)
    points, scene, v = points[known], scene[known], v[known]
    cameras, squares = [], []
    for view, camera in enumerate(rig.cameras):
        drawn = grid.pixels(view, scene + rig._offsets[view] * v[:, None])

        def changed(step: Array, camera: ViewCamera = camera) -> ViewCamera:
            ratio = 1 + step[3]
            return replace(
                camera,
                position=camera.position + step[:3],
                focal=(camera.focal[0] * ratio, camera.focal[1] * ratio),
                principal_point=(camera.principal_point[0] + step[4], camera.principal_point[1] + step[5]),
                distortion=tuple(step[6:].tolist()),
            )

        def residuals(step: Array, make: Any = changed, drawn: Array = drawn) -> Array:
            return np.ravel(make(step).project(points) - drawn)

        found = least_squares(residuals, np.zeros(10), x_scale="jac")
        cameras.append(changed(found.x))
        squares.append(float(np.mean(found.fun**2)) * 2)
    return replace(rig, cameras=tuple(cameras), error=float(np.sqrt(np.mean(squares))))
