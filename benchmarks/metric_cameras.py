"""Metric calibration of random simulated cameras: `python -m benchmarks.metric_cameras FIRST LAST
[SAMPLES]`.

Cameras are telescopic and binocular in turn, every second pair with three lens types, with tilt,
distortion and a decentred principal point. Each takes eight flats and a white image of 1000 x 800
px; only the sizes of pixel and square are given. The command prints errors of optics and poses over
their stated errors. Sideways, it also prints the largest Cramer-Rao error of any pose for the noise
of the corners (without widening), because the principal point moves all poses.
"""

from __future__ import annotations

import sys

import numpy as np

import lfcal
from data_synth import BoardShoot, Camera, shoot_board
from lfcal import Board, LightFieldError, MetricCalibration, calibrate_metric

from .metric_boards import cramer_rao, joint_misfit

_SIZE = (1000, 800)
_POSES = 8
_TELESCOPIC = (0.36, 0.17)
_BINOCULAR = (-0.5, -0.18)


def random_camera(seed: int) -> tuple[Camera, tuple[float, float]]:
    """A camera and the range of `s / D` of its boards."""
    rng = np.random.default_rng(seed)
    telescopic = seed % 2 == 1
    three = (seed // 2) % 2 == 1
    focus = (0.18, 0.26, 0.36) if telescopic else (-0.45, -0.3, -0.2)
    lattice = "hex" if three else ("hex", "square", "hex-vertical")[seed % 3]
    camera = Camera.design(
        _SIZE,
        float(rng.uniform(24, 30)),
        lattice,
        float(rng.uniform(-3, 3)),
        focus=focus if three else focus[1],
        fill=0.2,
        focal_length=float(rng.uniform(25, 50)),
    )
    if not telescopic:
        # Focused beyond infinity: binocular from near to far.
        camera = _with_mla_distance(camera, 0.994 * camera.focal_length)
    tilt = np.deg2rad(rng.uniform(-0.2, 0.2, 2))
    middle = np.array(_SIZE) / 2 + rng.uniform(-15, 15, 2)
    camera = camera.replace(
        k1=float(rng.uniform(-0.3, 0.3)),
        tilt=(float(tilt[0]), float(tilt[1])),
        principal_point=(float(middle[0]), float(middle[1])),
    )
    return camera, _TELESCOPIC if telescopic else _BINOCULAR


def _with_mla_distance(camera: Camera, distance: float) -> Camera:
    """The same array at another distance from the main lens, its microlenses focused at the same `s
    / D`.
    """
    powers = 1 / np.array(camera.microlens_focal_lengths)
    b = camera.sensor_distance
    old = camera.mla_distance
    ratios = (powers - 1 / b - 1 / old) * b / (1 + b / old)
    new = ratios * (1 + b / distance) / b + 1 / distance + 1 / b
    return camera.replace(
        mla_distance=distance,
        microlens_focal_lengths=tuple((1 / new).tolist()),
        aperture=camera.aperture * distance / old,
    )


def true_parameters(camera: Camera) -> np.ndarray:
    """True parameters in the order of `Optics.parameters`."""
    lengths = [camera.focal_length, camera.mla_distance, camera.sensor_distance]
    return np.array([*lengths, *camera.principal_point, camera.k1, 0, 0, 0, 0, *camera.tilt, 0, 0])


def report(seed: int, camera: Camera, shoot: BoardShoot, found: MetricCalibration) -> None:
    """Print one camera."""
    true = true_parameters(camera)
    optics = found.optics
    fitted = optics.standard_errors > 0
    within = (np.abs(optics.parameters - true) / np.where(fitted, optics.standard_errors, 1))[
        fitted
    ]
    chosen = [int(pose.name.split()[-1]) - 1 for pose in found.poses]
    off = np.array(
        [p.translation - shoot.translations[n] for p, n in zip(found.poses, chosen, strict=True)]
    )
    stated = np.array([p.standard_errors[3:] for p in found.poses])
    turns = [
        np.trace(p.rotation @ shoot.rotations[n].T)
        for p, n in zip(found.poses, chosen, strict=True)
    ]
    angle = np.rad2deg(np.arccos(np.clip((np.array(turns) - 1) / 2, -1, 1))).max()
    bound = cramer_rao(found)[:, 3:5].max()
    depth = off[:, 2] / shoot.translations[chosen, 2]
    print(
        f"{seed:3d} {'telescopic' if seed % 2 else 'binocular':10s} "
        f"{len(camera.microlens_focal_lengths)} types, "
        f"{len(chosen)} flats, rms {found.rms:.4f} px, noise {found.noise:.4f}, widened "
        f"{found.widening:.2f}; "
        f"sideways {np.abs(off[:, :2]).max():.4f} mm (bound {bound:.4f}), "
        f"depth {100 * np.abs(depth).max():.4f} %, turn {angle:.4f} deg, "
        f"poses/stated {np.sqrt((off**2 / stated**2).mean()):.2f}; F "
        f"{optics.focal_length - true[0]:+.3f} +- "
        f"{optics.standard_errors[0]:.3f} mm; parameters off / stated "
        f"{np.round(within, 1).tolist()}, jointly "
        f"{joint_misfit(found, true):.2f} squares each; "
        f"fitted {' '.join(found.fitted[6:])}",
        flush=True,
    )


def main(first: int, last: int, samples: int = 32) -> None:
    """Photograph and calibrate cameras `first` to `last - 1`."""
    for seed in range(first, last):
        camera, ratios = random_camera(seed)
        shoot = shoot_board(camera, _POSES, ratios=ratios, samples=samples, seed=seed)
        try:
            array = lfcal.calibrate(shoot.white, kind="white")
            found = calibrate_metric(
                shoot.flats, array, Board(9, 6, shoot.square), pixel=camera.pixel
            )
        except LightFieldError as error:
            print(f"{seed:3d} {error}", flush=True)
            continue
        report(seed, camera, shoot, found)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
