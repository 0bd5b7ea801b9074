"""Corners of a board in the microimages of a flat: predicted, then measured on pixels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..boards.board import Board
from ..boards.corner_fit import fit_corners
from ..boards.detection import DetectedBoard, FocusSweep, detect, other_size
from ..camera.calibration import Calibration
from ..camera.lens_types import LensBlur
from ..images.mosaic import equalise_mosaic, find_mosaic
from ..images.preprocessing import luminance
from ..lattice.robust_fit import robust_sigma
from ..lens_blur.boards import Edges, fit_discs
from ..runtime.arrays import Array, Integers, Singles
from .bundle_adjustment import Observations, Poses
from .camera_model import project

__all__ = ["BoardFlat", "measure", "measure_blur", "prepare"]

#: Corners in microimages whose blur is measured of each flat: their medians scatter by 0.002 px.
_BLURRED = 300

# Least relative contrast of a picture on which a board is looked for.
_LEAST_CONTRAST = 0.02
# Corners that must be found of a large board; a false ChArUco detection has fewer.
_LEAST_CORNERS = 10
# Least distance of a corner from the rim of a microimage [px], so that all four squares are seen,
# and the blur [px] above which the distance grows by two blurs.
_MARGIN = 3
_SHARP = 0.5
# Error of the fitted shape of edges, besides the noise of the pixels [px].
_EDGE_ERROR = 0.005
# Least `s / D` of a board: smaller patches are not looked for.
_LEAST_RATIO = 0.02
# Step of the differences that give the shape of a corner in a microimage [squares].
_STEP = 0.1


class BoardFlat(NamedTuple):
    """A flat divided by the gain of its camera, and the board that was detected on it."""

    name: str
    light: Singles  # (h, w)
    detected: DetectedBoard | None
    reason: str = ""  # reason why no board was found
    other: str = ""  # numbers of corners of another checkerboard that the flat shows


def prepare(
    flat: Array, name: str, calibration: Calibration, board: Board, sweep: FocusSweep
) -> BoardFlat:
    """Divide a flat by the gain of the camera and detect the board on its all-in-focus picture."""
    mosaic = flat.ndim == 2 and (calibration.mosaic or find_mosaic(flat))
    light = equalise_mosaic(flat) if mosaic else luminance(flat)
    if calibration.gain_map is not None or calibration.vignetting is not None:
        light = calibration.flatten(light)
    light = np.ascontiguousarray(light, np.float32)
    picture = sweep.draw(light)
    inner = picture.image[picture.image > 0]
    if inner.size < 100 or float(inner.std()) < _LEAST_CONTRAST * float(inner.mean()):
        return BoardFlat(name, light, None, "the picture has no contrast")
    found = detect(picture, board)
    other = other_size(picture.image, board, larger=found is not None)
    if found is None:
        but = other and f", but one of {other} corners"
        reason = f"no {board} in its all-in-focus picture{but}"
        return BoardFlat(name, light, None, reason, other)
    if len(found.corner) < min(_LEAST_CORNERS, len(board.points)):
        return BoardFlat(name, light, None, "too few corners", other)
    return BoardFlat(name, light, found, other=other)


def measure(
    flats: Sequence[BoardFlat],
    calibration: Calibration,
    board: Board,
    camera: Array,
    pixel: float,
    poses: Poses,
) -> Observations:
    """Fit the corners of boards in known poses in all microimages that show them."""
    lattice = calibration.lattice
    parts = []
    centres = lattice.centres()
    tree = cKDTree(centres)
    for m, flat in enumerate(flats):
        assert flat.detected is not None
        pose = Poses(poses.rotation[m : m + 1], poses.translation[m : m + 1])
        corner, centre, predicted, shape = _predict(
            camera, pixel, pose, board, flat.detected.corner, centres, tree, lattice.radius
        )
        fits = fit_corners(flat.light, centre, lattice.radius, predicted, shape, board)
        inside = lattice.radius - _MARGIN - 2 * (fits.blur - _SHARP)
        kept = fits.good & (np.hypot(*(fits.position - centre).T) < inside)
        sign = _expected_sign(board, corner, np.where(kept, fits.contrast, 0))
        kept &= np.sign(fits.contrast) == sign
        error = np.hypot(fits.error, _EDGE_ERROR)
        columns = (np.full(len(corner), m), corner, centre, fits.position, error)
        parts.append([column[kept] for column in columns])
    return Observations(*(np.concatenate(column) for column in zip(*parts, strict=True)))


class _Sample(NamedTuple):
    """Some corners of a flat in microimages, at depths that are known."""

    light: Singles  # (h, w) of the flat
    ratio: Array  # (n,) s / D
    kind: Integers  # (n,) lens type
    centre: Array  # (n, 2) [px] of the microimage
    predicted: Array  # (n, 2) [px]
    shape: Array  # (n, 2, 2) as `fit_corners`


def measure_blur(
    flats: Sequence[BoardFlat],
    calibration: Calibration,
    board: Board,
    camera: Array,
    pixel: float,
    poses: Poses,
) -> LensBlur | None:
    """The discs of the microlenses from the edges of boards in known poses.

    None if the aperture does not follow from the boards. Lenses blur light: if the camera file does
    not say whether values are in proportion to it or to its square root, the edges show which fits
    better.
    """
    lattice = calibration.lattice
    types = calibration.lens_types
    centres = lattice.centres()
    kinds = np.zeros(len(centres), np.int64)
    count = 1
    if types is not None:
        kinds = types.of(lattice.indices()).astype(np.int64)
        count = types.count
    tree = cKDTree(centres)
    samples = []
    for m, flat in enumerate(flats):
        assert flat.detected is not None
        pose = Poses(poses.rotation[m : m + 1], poses.translation[m : m + 1])
        corners = _predict(
            camera, pixel, pose, board, flat.detected.corner, centres, tree, lattice.radius
        )
        some = slice(None, None, max(1, len(corners[0]) // _BLURRED))
        corner, centre, predicted, shape = (values[some] for values in corners)
        points = board.points[corner] - board.middle
        depth = pose.of_board(points, np.zeros(len(points), np.int64))[:, 2]
        ratio = 1 / (camera[1] + camera[2] / depth)
        kind = kinds[tree.query(centre)[1]]
        samples.append(_Sample(flat.light, ratio, kind, centre, predicted, shape))
    powers = [1.0, 2.0]
    if calibration.encoded is not None:
        powers = [2.0 if calibration.encoded else 1.0]
    fits = [_fit_edges(samples, power, lattice.radius, board) for power in powers]
    edges, _ = min(fits, key=lambda fit: fit[1])
    return fit_discs(edges, count, lattice.pitch, calibration.lens_blur)


def _fit_edges(
    samples: list[_Sample], power: float, radius: float, board: Board
) -> tuple[Edges, float]:
    """The median blur of each flat and lens type, and the median error of the corners [px].

    Light is taken as this power of the values.
    """
    rows = []
    errors = []
    for sample in samples:
        light = np.maximum(sample.light, 0) ** np.float32(power)
        fits = fit_corners(
            light, sample.centre, radius, sample.predicted, sample.shape, board, linear=True
        )
        kept = fits.good & (np.hypot(*(fits.position - sample.centre).T) < radius - 3)
        errors.append(fits.error[kept])
        for kind in np.unique(sample.kind[kept]):
            own = kept & (sample.kind == kind)
            blur = fits.blur[own]
            width = np.median(blur)
            spread = robust_sigma(blur - width)
            rows.append((kind, np.median(sample.ratio[own]), width, spread))
    kinds, ratios, widths, spreads = np.array(rows, np.float64).reshape(-1, 4).T
    error = np.inf
    if rows:
        error = float(np.median(np.concatenate(errors)))
    return Edges(kinds.astype(np.int64), ratios, widths, spreads), error


def _expected_sign(board: Board, corner: Array, contrast: Array) -> Array:
    """(n,) sign of the contrast of each corner, of either polarity as most contrasts (n,) have it.

    It alternates between the corners of squares and is the same for all circles.
    """
    sign = np.ones(len(corner))
    if board.pattern != "circles":
        sign[(corner % board.columns + corner // board.columns) % 2 == 0] = -1.0
    if float((sign * contrast).sum()) >= 0:
        return sign
    return -sign


def _predict(
    camera: Array,
    pixel: float,
    pose: Poses,
    board: Board,
    corners: Array,
    centres: Array,
    tree: Any,
    radius: float,
) -> tuple[Array, Array, Array, Array]:
    """Corner, centre, position and shape of each corner in each microimage that shows it."""
    points = board.points - board.middle
    seen = pose.of_board(points[corners], np.zeros(len(corners), int))
    scene = camera[3:5] + camera[0] * seen[:, :2] / seen[:, 2:]
    ratio = 1 / (camera[1] + camera[2] / seen[:, 2])
    # Distortion and tilt move scene coordinates by less than a diameter of microimages.
    reach = radius / np.maximum(np.abs(ratio), _LEAST_RATIO) + 2 * radius
    near = tree.query_ball_point(scene, reach)
    corner = np.repeat(corners, [len(k) for k in near])
    centre = centres[np.concatenate([np.asarray(k, int) for k in near])]

    def at(*shift: float) -> Array:
        moved = points[corner] + np.array([*shift, 0.0]) * board.square
        return project(camera, pixel, pose.of_board(moved, np.zeros(len(corner), int)), centre)

    kept = np.hypot(*(at(0, 0) - centre).T) < radius
    corner = corner[kept]
    centre = centre[kept]
    across = at(_STEP, 0) - at(-_STEP, 0)
    down = at(0, _STEP) - at(0, -_STEP)
    return corner, centre, at(0, 0), np.stack([across, down], 2) / (2 * _STEP)
