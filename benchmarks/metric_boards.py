"""Metric calibration of foreign data: `python -m benchmarks.metric_boards [SHARED]`.

`boards/` is ray-traced by an independent program. Optics, poses and corners of all twelve flats
are compared with the truth; each half of the flats also calibrates for the corners of the other
half. `metric/` holds corners of a real Raytrix R12, published with the toolbox COMPOTE. The
command prints their RMS distance, F with its error, and the measured size of the boards over the
true size.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import lfcal
from lfcal import Board, MetricCalibration, calibrate_metric, locate_board
from lfcal.boards.detection import DetectedBoard
from lfcal.metric.bundle_adjustment import BASE, Observations, Poses, adjust, select_order
from lfcal.metric.calibrate import DEFAULT_PIXEL
from lfcal.metric.result import pose_of
from lfcal.metric.start import first_camera
from lfcal.metric.uncertainty import describe_degeneracies, internal_camera, optics_of, pose_factor

__all__ = ["cramer_rao", "joint_misfit", "main", "ray_traced", "real_r12"]

_SQUARE = 10.0  # of the R12's board, mm
_ROWS = 5
_COLUMNS = 9


def ray_traced(folder: Path) -> dict[str, float]:
    """Print the figures of `boards/`.

    Returns the largest errors of the poses: sideways [mm], and depth [% of the distance].
    """
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    known = truth["camera"]
    poses = truth["poses"]
    flats = [lfcal.read_flat(folder / pose["file"]) for pose in poses]
    camera = lfcal.calibrate(lfcal.read_flat(folder / "white.png"), kind="white")
    board = Board(9, 6, truth["board"]["square_mm"])
    start = time.process_time()
    wall = time.perf_counter()
    found = calibrate_metric(flats, camera, board, pixel=known["pixel_mm"])
    print(
        f"{len(flats)} flats: {time.process_time() - start:.0f} s processor, "
        f"{time.perf_counter() - wall:.0f} s"
    )
    true = [
        known["F_mm"],
        known["mainlens_to_mla_mm"],
        known["mla_to_sensor_mm"],
        *known["principal_point_px"],
    ]
    off = found.optics.parameters[:6] - [*true, known["k1"]]
    print(
        f"F, L, b, principal point, k1 off / stated: "
        f"{np.round(off / found.optics.standard_errors[:6], 2)}; jointly "
        f"{joint_misfit(found, np.array([*true, known['k1'], *[0.0] * 8])):.2f} squares per "
        f"parameter"
    )
    errors = _print_poses(found, poses)
    left_out = []
    for half in (slice(0, None, 2), slice(1, None, 2)):
        some = calibrate_metric(flats[half], camera, board, pixel=known["pixel_mm"])
        rest = [k for k in range(len(flats)) if k not in range(len(flats))[half]]
        for k in rest:
            corners = np.array(poses[k]["corners_mm"])
            error = locate_board(flats[k], some.calibration, board).place(board.points) - corners
            left_out.append(
                np.column_stack([np.abs(error[:, 2]), np.hypot(*error[:, :2].T)])
                / corners[:, 2:]
                * 100
            )
    share = np.concatenate(left_out)
    print(
        f"corners of poses left out: depth {np.median(share[:, 0]):.4f} % median, "
        f"{share[:, 0].max():.4f} % at most; "
        f"sideways {np.median(share[:, 1]):.4f} % of the distance, {share[:, 1].max():.4f} % at "
        f"most"
    )
    return errors


def cramer_rao(found: MetricCalibration) -> np.ndarray:
    """(m, 6) least standard errors of the poses, in the order of theirs, that the noise of the
    corners allows.
    """
    optics = found.optics
    board = found.board
    camera, _ = internal_camera(optics)
    turns = np.array([pose.rotation for pose in found.poses])
    shifts = np.array([pose.translation + pose.rotation @ board.middle for pose in found.poses])
    points = board.points - board.middle
    seen = found.observations
    one = adjust(
        camera, optics.pixel, Poses(turns, shifts), points, seen, found.fitted, found.board_shape
    )
    one = replace(one, covariance=one.covariance / one.cluster)
    return np.array(
        [
            pose_of(one, m, board, seen, pose.name).standard_errors
            for m, pose in enumerate(found.poses)
        ]
    )


def joint_misfit(found: MetricCalibration, true: np.ndarray) -> float:
    """Squared errors of all fitted parameters, by the inverse of their stated covariance, over
    their number.
    """
    optics = found.optics
    assert optics.covariance is not None
    chosen = np.flatnonzero(optics.standard_errors > 0)
    off = (optics.parameters - true)[chosen]
    scale = optics.standard_errors[chosen]
    unit = optics.covariance[np.ix_(chosen, chosen)] / np.outer(scale, scale)
    return float((off / scale) @ np.linalg.solve(unit, off / scale)) / len(chosen)


def _print_poses(found: MetricCalibration, poses: list[dict]) -> dict[str, float]:
    sideways = []
    depth = []
    turn = []
    within = []
    bound = []
    for pose, true, least in zip(found.poses, poses, cramer_rao(found), strict=True):
        off = pose.translation - true["t_mm"]
        sideways.append(np.abs(off[:2]).max())
        depth.append(abs(off[2]) / true["t_mm"][2] * 100)
        cosine = (np.trace(pose.rotation @ np.transpose(true["R"])) - 1) / 2
        turn.append(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
        within.append(np.abs(off) / pose.standard_errors[3:])
        bound.append(np.abs(off) / least[3:])
    print(
        f"poses: sideways {max(sideways):.4f} mm, depth {max(depth):.4f} % of the distance, turn "
        f"{max(turn):.4f} deg "
        f"at most; {100 * np.mean(np.array(within) < 2):.0f} % of the positions within 2 stated "
        f"sigma; RMS "
        f"{np.sqrt(np.mean(np.square(bound))):.2f} Cramer-Rao bounds of a corner noise of "
        f"{found.noise:.4f} px"
    )
    return {"sideways": float(max(sideways)), "depth": float(max(depth))}


def triangulate(seen: Observations) -> list[DetectedBoard]:
    """Scene coordinates and `D / s` of the corners of each pose that two microimages or more see,
    without a camera.
    """
    boards = []
    for m in range(int(seen.pose.max()) + 1):
        found = []
        for corner in np.unique(seen.corner[seen.pose == m]):
            mine = (seen.pose == m) & (seen.corner == corner)
            centre = seen.centre[mine]
            delta = seen.position[mine] - seen.centre[mine]
            mean = centre.mean(0)
            if mine.sum() > 1:
                # p - c = (c - X) s / D: the slope of p - c over c.
                ratio = ((centre - mean) * delta).sum() / ((centre - mean) ** 2).sum()
                found.append((corner, *(mean - delta.mean(0) / ratio), 1 / ratio))
        table = np.array(found)
        boards.append(DetectedBoard(table[:, 0].astype(np.int64), table[:, 1:3], table[:, 3]))
    return boards


def real_r12(folder: Path) -> None:
    """Print the figures of `metric/`."""
    lenses = np.genfromtxt(folder / "R12-A.centres.csv", delimiter=",", names=True)
    corners = np.genfromtxt(folder / "R12-A.corners.csv", delimiter=",", names=True)

    def design(table: np.ndarray) -> np.ndarray:
        # Odd rows of the hexagonal array are shifted by half a pitch.
        return np.column_stack(
            [np.ones(len(table)), table["k"] + (table["l"] + 1) % 2 / 2, table["l"]]
        )

    measured = np.column_stack([lenses["u_px"], lenses["v_px"]])
    centres = design(corners) @ np.linalg.lstsq(design(lenses), measured, rcond=None)[0]
    _, pose = np.unique(corners["frame"], return_inverse=True)
    position = np.column_stack([corners["u_px"], corners["v_px"]])
    seen = Observations(pose, corners["corner"].astype(int), centres, position, np.ones(len(pose)))
    points = (
        np.array([[k % _COLUMNS, k // _COLUMNS, 0.0] for k in range(_COLUMNS * _ROWS)]) * _SQUARE
    )
    points -= points.mean(0)
    boards = triangulate(seen)
    start = first_camera(boards, points, (4080, 3068))
    assert start is not None
    fitted = adjust(start[0], DEFAULT_PIXEL, start[1], points, seen, BASE)
    chosen = select_order(fitted, DEFAULT_PIXEL, points, seen)
    for one in (fitted, chosen):
        factor = pose_factor(one)
        optics = optics_of(replace(one, covariance=one.covariance * factor), DEFAULT_PIXEL)
        errors = optics.standard_errors
        print(
            f"R12: {len(one.free)} parameters ({' '.join(one.free[6:])}), "
            f"{np.sqrt((one.residual**2).sum(1).mean()):.4f} px RMS over {len(seen)} corners; "
            f"F = {optics.focal_length:.2f} +- {errors[0]:.2f}, L = {optics.mla_distance:.2f} +- "
            f"{errors[1]:.2f}, "
            f"b = {optics.sensor_distance:.4f} +- {errors[2]:.4f} mm; variances widened by "
            f"{one.cluster * factor:.1f}"
        )
    print(*describe_degeneracies(optics), sep="\n")
    scale = []
    for board in boards:
        places = optics.positions(board.scene, 1 / board.inverse_ratio) * 1000
        plane = points[board.corner]
        spread, own = (np.linalg.norm(p - p.mean(0), axis=1) for p in (places, plane))
        scale.append(np.median(spread[own > 0] / own[own > 0]) - 1)
    size = 100 * np.median(scale)
    scatter = 100 * np.std(scale)
    print(f"boards measured without their squares: {size:+.2f} % in size, scatter {scatter:.2f} %")


def main(shared: str = "../shared") -> None:
    """Print all figures."""
    ray_traced(Path(shared) / "boards")
    real_r12(Path(shared) / "metric")


if __name__ == "__main__":
    main(*sys.argv[1:])
