"""The optics of a camera, and the poses of the boards, from flats of a board."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ..boards.board import Board
from ..boards.detection import DetectedBoard, FocusSweep
from ..camera.calibration import Calibration
from ..camera.optics import Optics
from ..runtime.arrays import Array
from ..runtime.errors import CAMERA_ADVICE, BoardError, FlatError, check_number, check_type
from ..runtime.progress import Progress, Step, show_progress
from .bundle_adjustment import (
    BASE,
    POSE,
    Adjusted,
    Observations,
    Poses,
    adjust,
    inverse,
    select_order,
)
from .camera_model import INTERNAL
from .observe import BoardFlat, measure, measure_blur, prepare
from .result import BoardPose, MetricCalibration, pose_of
from .start import first_camera, planar_poses
from .uncertainty import (
    describe_degeneracies,
    internal_camera,
    optics_of,
    pose_factor,
    rim_covariance,
)

__all__ = ["DEFAULT_PIXEL", "calibrate_metric", "locate_board"]


#: Side of a pixel [mm] if none is given; distances do not depend on it.
DEFAULT_PIXEL = 0.0055
# Fewest flats with the board.
_LEAST_FLATS = 3
# Share of outliers above which a flat does not belong to the camera.
_MOST_OUTLIERS = 0.4
# Residuals over the noise of the pixels above which the model is doubted.
_MOST_NOISE = 6
# Poses are alike if their tilts differ by less than this [degrees], and their distances by less
# than this factor.
_SAME_TILT = 4
_SAME_DISTANCE = 1.05
# Fewest corners that a flat must show in single microimages.
_LEAST_CORNERS = 6
_MOST_THREADS = 8


def calibrate_metric(
    flats: Sequence[ArrayLike],
    calibration: Calibration,
    board: Board | tuple[int, int],
    square: float | None = None,
    *,
    pixel: float | None = None,
    names: Sequence[str] | None = None,
    progress: Progress = None,
) -> MetricCalibration:
    """Measure main lens, distances, distortion and tilt of a camera on flats of a board.

    Parameters
    ----------
    flats : sequence of (h, w) or (h, w, 3) array_like
        Raw flats of one camera, three or more. A dozen is good, with the board tilted by 20 to 40
        degrees in different directions, at distances that differ by a factor of two or more and in
        all parts of the field.
    calibration : Calibration
        The array of this camera, as `calibrate` measures it on a white image.
    board : Board or (int, int)
        The board, or the inner corners across and down of a checkerboard.
    square : float [mm], optional
        Side of the squares; needed if `board` is a pair of numbers.
    pixel : float [mm], optional
        Side of a pixel of the sensor. F, L and b scale with it; distances do not depend on it. By
        default that of `calibration.optics`, or 0.0055 with a warning.
    names : sequence of str, optional
        Names of the flats, for messages and poses.
    progress : bool or callable, optional
        True shows a bar; a function is called with the numbers of searched and of all flats.

    Returns
    -------
    MetricCalibration
        The camera with its optics, the poses of the boards, and the covariance of both.

    Raises
    ------
    FlatError
        If a flat has another size than those of the camera.
    BoardError
        If the board is found on fewer than three flats, if more flats show a board of another size,
        if all poses are alike, or if the flats come from different cameras.

    Examples
    --------
    >>> import lfcal, lfrender
    >>> shoot = lfrender.data.board(size=(420, 340), pitch=28.3, poses=4, samples=8)
    >>> camera = lfcal.calibrate(shoot.white, kind="white")
    >>> board = lfcal.Board(9, 6, shoot.square)
    >>> found = lfcal.calibrate_metric(  # doctest: +SKIP
    ...     shoot.flats, camera, board, pixel=shoot.camera.pixel
    ... )
    >>> found.calibration.optics is found.optics  # doctest: +SKIP
    True
    """
    check_type(calibration, Calibration, "calibration", CAMERA_ADVICE)
    if isinstance(board, (tuple, list)):
        if square is None:
            raise BoardError(
                "give the side of the squares [mm] beside the corners of the board: square="
            )
        board = Board(*board, square)
    check_type(board, Board, "board", "give lfcal.Board, or its inner corners across and down")
    if not hasattr(flats, "__len__"):
        raise TypeError(f"flats must be a sequence of flats, got {type(flats).__name__}")
    names = list(names) if names is not None else [f"flat {m + 1}" for m in range(len(flats))]
    if len(names) != len(flats):
        raise ValueError(f"names must be one for each of {len(flats)} flats, got {len(names)}")
    if len(flats) < _LEAST_FLATS:
        raise BoardError(f"{len(flats)} flats of the board; give 3 or more, a dozen is good")
    warnings = []
    if pixel is None and calibration.optics is not None:
        pixel = calibration.optics.pixel
    if pixel is None:
        pixel = DEFAULT_PIXEL
        warnings.append(
            f"the size of a pixel is not given: {pixel * 1000:.3g} um is assumed; F, L and b "
            "scale with it"
        )
    if not 0 < check_number(pixel, "pixel") < 1:
        raise ValueError(f"pixel must be a positive number of mm below 1, got {pixel!r}")
    with show_progress(progress, "boards") as step:
        found, missing = _prepare_all(flats, names, calibration, board, step)
    warnings += [f"{flat.name}: {flat.reason}; left out" for flat in missing]
    fitted, observations = _fit(found, calibration, board, pixel)
    warnings += _doubts(fitted, board)
    return _result(fitted, pixel, calibration, board, found, observations, tuple(warnings))


def _fit(
    found: list[BoardFlat], calibration: Calibration, board: Board, pixel: float
) -> tuple[Adjusted, Observations]:
    """Camera and poses with the parameters that the data require, and the corners of the fit."""
    points = board.points - board.middle
    camera, poses = _first([flat.detected for flat in found if flat.detected], calibration, board)
    # The first camera predicts the corners, then the fitted camera predicts them better.
    for _ in range(2):
        observations = measure(found, calibration, board, camera, pixel, poses)
        _check_seen(observations, found)
        fitted = adjust(camera, pixel, poses, points, observations, BASE)
        camera = fitted.camera
        poses = fitted.poses
    # Blur and light differ from pose to pose, and so does the scatter of the corners.
    pose = observations.pose
    square = (fitted.residual**2).sum(1) / observations.error**2 * fitted.weight
    noise = np.sqrt(np.bincount(pose, square) / (2 * np.bincount(pose, fitted.weight)))
    observations = replace(observations, error=observations.error * noise[pose])
    fitted = adjust(camera, pixel, poses, points, observations, BASE)
    fitted = select_order(fitted, pixel, points, observations)
    outliers = 1 - np.bincount(pose, fitted.weight) / np.bincount(pose)
    lost = [found[m].name for m in np.flatnonzero(outliers > _MOST_OUTLIERS)]
    if lost:
        raise BoardError(
            f"{', '.join(lost)}: the board does not fit the camera of the other flats; were focus, "
            "zoom or camera changed, or is it another board? Leave these flats out"
        )
    return fitted, observations


def _doubts(fitted: Adjusted, board: Board) -> list[str]:
    """Warnings about a fitted camera."""
    warnings = []
    if fitted.noise > _MOST_NOISE:
        warnings.append(
            f"corners lie {fitted.noise:.0f} times as far from the model as their noise explains; "
            "is the board flat, are squares and pixel right, was nothing moved?"
        )
    if fitted.shape.any():
        off = fitted.board - board.points + board.middle
        warnings.append(
            f"the board is not flat and square (bent by {np.ptp(off[:, 2]):.2g} mm, points "
            f"{np.hypot(*off[:, :2].T).max():.2g} mm aside), which is reckoned with; one on glass "
            "or aluminium measures better"
        )
    return warnings


def locate_board(
    flat: ArrayLike, calibration: Calibration, board: Board, *, name: str = "flat"
) -> BoardPose:
    """Pose of a board in front of a camera that `calibrate_metric` has measured.

    Its covariance contains the noise of the corners and the errors of the camera.

    Raises
    ------
    FlatError
        If the flat has another size than those of the camera.
    BoardError
        If the board is not found, or the camera has no optics.

    Examples
    --------
    >>> camera = lfcal.load("camera.json")  # doctest: +SKIP
    >>> board = lfcal.Board(9, 6, 7.0)  # doctest: +SKIP
    >>> flat = lfcal.read_flat("board.png")  # doctest: +SKIP
    >>> pose = lfcal.locate_board(flat, camera, board)  # doctest: +SKIP
    >>> pose.translation, pose.standard_errors[3:]  # doctest: +SKIP
    """
    check_type(calibration, Calibration, "calibration", CAMERA_ADVICE)
    check_type(board, Board, "board", "give lfcal.Board")
    optics = calibration.optics
    if optics is None or optics.principal_point is None:
        raise BoardError("the camera has no measured optics; make them with calibrate_metric")
    prepared = prepare(
        _checked(flat, name, calibration), name, calibration, board, FocusSweep(calibration.lattice)
    )
    if prepared.detected is None:
        raise BoardError(f"{name}: {prepared.reason}")
    camera, change = internal_camera(optics)
    points = board.points - board.middle
    detected = prepared.detected
    tried = []
    corners = points[detected.corner]
    for turn, shift in planar_poses(detected.scene, corners, camera[0], camera[3:5]):
        pose = Poses(turn[None], shift[None])
        for _ in range(2):
            observations = measure([prepared], calibration, board, camera, optics.pixel, pose)
            _check_seen(observations, [prepared])
            found = adjust(camera, optics.pixel, pose, points, observations, ())
            pose = found.poses
        tried.append((found.noise * np.sqrt(found.cluster), found, observations))
    if not tried:
        raise BoardError(f"{name}: the board shows no pose; move it or tilt it less")
    _, found, observations = min(tried, key=lambda one: one[0])
    shared = rim_covariance(found, optics.pixel, observations, calibration.lattice.radius)
    covariance = found.covariance + shared
    if optics.covariance is not None:
        # Errors of the camera move the pose.
        normal = found.normal[0]
        own = np.ix_(POSE, POSE)
        by_optics = inverse(normal[own]) @ normal[POSE, : len(INTERNAL)] @ change
        covariance[own] += by_optics @ optics.covariance @ by_optics.T
    return pose_of(replace(found, covariance=covariance), 0, board, observations, name)


def _checked(flat: ArrayLike, name: str, calibration: Calibration) -> Array:
    pixels = np.asarray(flat)
    width, height = calibration.image_size
    if pixels.ndim not in (2, 3) or pixels.shape[:2] != (height, width):
        size = " x ".join(str(n) for n in pixels.shape[1::-1])
        raise FlatError(
            f"{name} is {size} px, the camera is for {width} x {height} px; give flats of "
            "one camera"
        )
    return pixels


def _prepare_all(
    flats: Sequence[ArrayLike],
    names: Sequence[str],
    calibration: Calibration,
    board: Board,
    step: Step,
) -> tuple[list[BoardFlat], list[BoardFlat]]:
    """Flats on which the board was found, and flats on which it was not."""
    checked = [_checked(flat, name, calibration) for flat, name in zip(flats, names, strict=True)]
    sweep = FocusSweep(calibration.lattice)
    with ThreadPoolExecutor(max(1, min(len(checked), os.cpu_count() or 1, _MOST_THREADS))) as pool:
        jobs = [
            pool.submit(prepare, flat, name, calibration=calibration, board=board, sweep=sweep)
            for flat, name in zip(checked, names, strict=True)
        ]
        for done, _ in enumerate(as_completed(jobs), 1):
            step(done, len(jobs))
    prepared = [job.result() for job in jobs]
    found = [flat for flat in prepared if not flat.reason]
    missing = [flat for flat in prepared if flat.reason]
    others = Counter(flat.other for flat in prepared if flat.other)
    size, number = max(others.items(), key=lambda one: one[1], default=("", 0))
    # A few flats of another scene may show a small board by chance.
    if number > sum(not flat.other for flat in found) and 2 * number >= len(prepared):
        raise BoardError(
            f"{number} of {len(prepared)} flats show a checkerboard of {size} corners, not of "
            f"{board.columns} x {board.rows}: give the number of its inner corners"
        )
    if len(found) < _LEAST_FLATS:
        reasons = "; ".join(f"{flat.name}: {flat.reason}" for flat in missing)
        raise BoardError(
            f"the {board} was found on {len(found)} of {len(prepared)} flats, 3 are needed "
            f"({reasons}); show all of the board, well lit and in focus, and check the number of "
            "its inner corners"
        )
    return found, missing


def _first(
    boards: list[DetectedBoard], calibration: Calibration, board: Board
) -> tuple[Array, Poses]:
    """Camera and poses to start from."""
    start = first_camera(boards, board.points - board.middle, calibration.image_size)
    if start is None:
        raise BoardError(
            "no camera explains the boards; check the number of squares, and that all flats are of "
            "this camera"
        )
    normals = start[1].rotation[:, :, 2]
    angle = np.rad2deg(np.arccos(np.clip(normals @ normals.T, -1, 1))).max()
    distances = start[1].translation[:, 2]
    factor = distances.max() / distances.min()
    if angle < _SAME_TILT and factor < _SAME_DISTANCE:
        raise BoardError(
            f"all {len(boards)} poses of the board are alike (within {angle:.1f} degrees and "
            f"{100 * (factor - 1):.0f} % of the distance), which tells nothing about the lenses; "
            "tilt it by 20 to 40 degrees in different directions, and vary its distance"
        )
    return start


def _check_seen(observations: Observations, flats: Sequence[BoardFlat]) -> None:
    """Raise BoardError with the names of flats whose microimages show too few corners."""
    seen = np.unique([observations.pose, observations.corner], axis=1)[0]
    counts = np.bincount(seen, minlength=len(flats))
    blind = [flats[m].name for m in np.flatnonzero(counts < _LEAST_CORNERS).tolist()]
    if blind:
        raise BoardError(
            f"{', '.join(blind)}: no corners are seen in single microimages; they are "
            "blurred there, "
            "or squares are wider than microimages: use a board of smaller squares, or move it"
        )


def _result(
    fitted: Adjusted,
    pixel: float,
    calibration: Calibration,
    board: Board,
    flats: Sequence[BoardFlat],
    observations: Observations,
    warnings: tuple[str, ...],
) -> MetricCalibration:
    factor = pose_factor(fitted)
    shared = rim_covariance(fitted, pixel, observations, calibration.lattice.radius)
    widened = replace(fitted, covariance=fitted.covariance * factor + shared)
    optics = optics_of(widened, pixel)
    optics = replace(optics, microlens_focal_lengths=_microlenses(optics, calibration))
    blur = measure_blur(flats, calibration, board, fitted.camera, pixel, fitted.poses)
    return MetricCalibration(
        calibration=replace(calibration, optics=optics, lens_blur=blur or calibration.lens_blur),
        board=board,
        poses=tuple(
            pose_of(widened, m, board, observations, flat.name) for m, flat in enumerate(flats)
        ),
        fitted=fitted.free,
        observations=observations,
        residual=fitted.residual,
        used=fitted.weight > 0,
        noise=float(np.median(observations.error)) * fitted.noise,
        widening=fitted.cluster * factor,
        degeneracies=describe_degeneracies(optics),
        warnings=warnings,
        board_shape=fitted.shape,
    )


def _microlenses(optics: Optics, calibration: Calibration) -> tuple[float, ...]:
    """Focal length [mm] of each lens type, if it is known at which `s / D` each is in focus."""
    types = calibration.lens_types
    if types is None or types.focus is None or not np.isfinite(types.focus).all():
        return ()
    far = optics.mla_distance
    near = optics.sensor_distance
    image = types.focus * (1 + near / far) / near + 1 / far
    return tuple((1 / (image + 1 / near)).tolist())
