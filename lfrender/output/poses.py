"""Views as pictures of pinhole cameras in the aperture of the main lens.

A view reads the flat at `Y = X + q D / s` (docs/geometry.md), so that its parallax is linear in the
virtual depth `D / s`, as is that of pinhole cameras in `1 / Z`. With the optics known, positions
and depth are metric; without, the focal length is chosen, the baseline between neighbouring views
is 1, and the scene is right up to a projective transformation that leaves all views as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from lfcal import Calibration, Optics
from lfcal.runtime.arrays import MOST, Array, Floats, Frozen, Singles

from ..data.depth_map import DepthMap, check_depth
from ..rendering.warped_surface import virtual_depth
from ..runtime.types import Place, Size

__all__ = ["ViewCamera", "ViewRig", "view_rig"]

# Without optics, infinity lies behind the scene by this share of its range of virtual depth, which
# is at least so many pitches: nearer, the far end of the scene would be stretched most.
_BEYOND = 0.25
_LEAST_DEPTH = 0.1
# Places on each axis of the flat, and the shares of its sides and of the depths between which they
# lie, to which the camera of each view is fitted.
_PLACES = 9
_INNER = (0.02, 0.98)


@dataclass(frozen=True, eq=False)
class ViewCamera(Frozen):
    """A pinhole camera; its axes are x right, y down, z forward, those of all cameras of a rig.

    Examples
    --------
    >>> import numpy
    >>> camera = ViewCamera(numpy.zeros(3), (100.0, 100.0), (50.0, 40.0), (101, 81))
    >>> camera.project([[0.1, 0.0, 1.0]])
    array([[60., 40.]])
    """

    position: Floats  # (3,) in the unit of the rig
    focal: Place  # [px]
    principal_point: Place  # [px], pixel centres at integers
    size: Size  # width and height [px]
    distortion: tuple[float, ...] = (0.0,) * 4  # k1, k2, p1, p2 as OpenCV has them

    def project(self, points: ArrayLike) -> Floats:
        """(n, 2) pixels `u, v` at which points (n, 3) are seen."""
        import cv2

        places = np.asarray(points, np.float64) - self.position
        found, _ = cv2.projectPoints(places, np.zeros(3), np.zeros(3), *self._model())
        return np.asarray(found[:, 0])

    def rays(self, pixels: ArrayLike) -> Floats:
        """(n, 3) rays `x / z, y / z, 1` that pixels (n, 2) see along."""
        import cv2

        slopes = cv2.undistortPoints(np.asarray(pixels, np.float64), *self._model())[:, 0]
        return np.column_stack([slopes, np.ones(len(slopes))])

    def _model(self) -> tuple[Floats, Floats]:
        """Matrix and distortion, for OpenCV."""
        matrix = np.diag([*self.focal, 1.0])
        matrix[:2, 2] = self.principal_point
        return matrix, np.array(self.distortion)


@dataclass(frozen=True)
class ViewRig:
    """The cameras of several views of one scene.

    Examples
    --------
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> picture = lfrender.render(flat, camera, depth, scale=6)
    >>> offsets = [(-4.0, 0.0), (4.0, 0.0)]
    >>> rig = view_rig(camera, depth, offsets, picture.affine, (62, 47), still=-7.0)
    >>> len(rig.cameras), rig.unit
    (2, 'baseline')
    """

    cameras: tuple[ViewCamera, ...]
    unit: str  # "m", or "baseline" of neighbouring views
    error: float  # RMS distance of what the cameras project from what the optics do [px]
    # Distance (n,) of virtual depths (n,) that a view draws at (n, 2) [px of the flat].
    _distance: Callable[[int, Floats, Floats], Floats] = field(repr=False, compare=False)
    _pitch: float = field(repr=False)

    def depth(self, view: int, patch_size: Array, places: Floats) -> Singles:
        """Distance along the axis (h, w), float32, of the pixels of the view number `view`.

        The unit is that of the rig.

        `patch_size` (h, w) [px] is drawn at `places` (h, w, 2) [px] on the microlens plane, `Y`. It
        is inf at infinity, NaN where the optics can image nothing.
        """
        virtual = virtual_depth(np.asarray(patch_size, np.float32), self._pitch).astype(np.float64)
        found = self._distance(view, virtual.ravel(), places.reshape(-1, 2))
        return found.reshape(virtual.shape).astype(np.float32)


def view_rig(
    calibration: Calibration,
    depth: DepthMap,
    offsets: Sequence[Place],
    affine: Floats,
    size: Size,
    still: float,
    optics: Optics | None = None,
) -> ViewRig:
    """The cameras of the views that `lfrender.views` draws for `offsets` and `still` [px].

    All views have the `affine` from pixel to scene coordinates, and the width and height `size`
    [px]. The optics are those of the calibration if no others are given.

    Examples
    --------
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> picture = lfrender.render(flat, camera, depth, scale=6)
    >>> view_rig(camera, depth, [(-4.0, 0.0)], picture.affine, (62, 47), still=-7.0).cameras[0].size
    (62, 47)
    """
    check_depth(depth, calibration)
    optics = optics or calibration.optics
    middle = (np.array(calibration.image_size) - 1) / 2
    pitch = calibration.lattice.pitch
    where = np.array(offsets, dtype=float).reshape(-1, 2)
    step = np.diag(affine)
    moved = where * (pitch / still)
    virtual = virtual_depth(depth.surface.patch_size, depth.pitch)

    def cameras(aside: Floats, focal: float, centres: Floats) -> tuple[ViewCamera, ...]:
        """Cameras at places `aside` (n, 2).

        Focal length and principal points (n, 2) are measured on the microlens plane.
        """
        fx, fy = focal / step
        points = (centres - moved - affine[:, 2]) / step
        return tuple(
            ViewCamera(np.array([*place, 0.0]), (fx, fy), (x, y), size)
            for place, (x, y) in zip(aside, points.tolist(), strict=True)
        )

    if optics is None:
        # In units of the baseline: the focal length is the longer side, infinity a little behind
        # the scene, where `D / s = beyond` is drawn at X + q beyond.
        near, far = np.percentile(virtual, MOST).tolist()
        beyond = far + _BEYOND * max(far - near, _LEAST_DEPTH)
        focal = float(max(depth.image_size))
        gaps = np.linalg.norm(where[:, None] - where, axis=-1)
        unit = float(gaps[gaps > 0].min(initial=np.inf))
        if np.isinf(unit):
            unit = 1.0

        def chosen_distance(_view: int, depths: Floats, _places: Floats) -> Floats:
            with np.errstate(divide="ignore"):
                return np.where(depths < beyond, focal / unit / (beyond - depths), np.inf)

        made = cameras(where / unit, focal, middle + where * beyond)
        return ViewRig(made, "baseline", 0.0, chosen_distance, pitch)
    lens = optics
    axis = middle
    if lens.principal_point is not None:
        axis = np.array(lens.principal_point)
    far = lens.mla_distance
    spread = 1 + lens.sensor_distance / far
    # The lens at c is read at c + q: the ray crosses the main lens there.
    aside = where * lens.pixel * far / lens.sensor_distance
    centres = axis - spread / lens.pixel * aside * (1 - far / lens.focal_length)
    made = cameras(aside * 1e-3, spread * far / lens.pixel, centres)
    error = 0.0
    if any((*lens.radial, *lens.tangential, *lens.tilt, lens.curvature, lens.pupil)):
        # Optics with distortion, tilt, curvature or a pupil: the cameras that come nearest.
        sides = [np.linspace(*_INNER, _PLACES) * side for side in depth.image_size]
        low, high = _INNER
        depths = np.quantile(virtual, (low, 0.5, high))
        x, y, v = (axis.ravel() for axis in np.meshgrid(*sides, depths))
        scene = np.column_stack([x, y])
        points = lens.positions(scene, 1 / v.astype(np.float64), middle)
        known = np.isfinite(points).all(1)
        fitted = []
        for camera, q, own in zip(made, where, moved, strict=True):
            drawn = (scene + q * v[:, None] - own - affine[:, 2]) / step
            fitted.append(_fit(camera, points[known], drawn[known]))
        made = tuple(camera for camera, _ in fitted)
        error = float(np.sqrt(np.mean([square for _, square in fitted])))

    def distance(view: int, depths: Floats, places: Floats) -> Floats:
        found = lens.positions(places - where[view] * depths[:, None], 1 / depths, middle)
        return np.asarray(found[:, 2] - made[view].position[2])

    return ViewRig(made, "m", error, distance, pitch)


def _fit(camera: ViewCamera, points: Floats, pixels: Floats) -> tuple[ViewCamera, float]:
    """The camera that projects points (n, 3) nearest to pixels (n, 2), and the squared error."""
    from scipy.optimize import least_squares

    def changed(step: Floats) -> ViewCamera:
        position = camera.position + step[:3]
        focal = np.array(camera.focal) * (1 + step[3])
        at = np.array(camera.principal_point) + step[4:6]
        return ViewCamera(position, tuple(focal), tuple(at), camera.size, tuple(step[6:].tolist()))

    def differ(step: Floats) -> Floats:
        return np.ravel(changed(step).project(points) - pixels)

    found = least_squares(differ, np.zeros(10), x_scale="jac")
    return changed(found.x), float(np.mean(found.fun**2)) * 2
