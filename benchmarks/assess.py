"""Errors of `lfcal.assess` on random cameras: `python -m benchmarks.assess FIRST LAST`.

Hexagonal both ways and square; turned by 0 to 3 degrees, a sensor tilted by 0 to 0.5 degrees in any
direction, gaps of -10 to +20 %, microlenses open over 0.3 to 0.95 of their pitch and focused at s
of -0.25 to 0.25 D; 8 bits encoded or linear, and 16 bits. The
command prints values, stated errors and truth, then how many are within one, two and more errors.
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray

import lfcal
from data_synth import Camera, tracing
from data_synth.transfer import develop
from lfcal import LightFieldError

_LATTICES = ("hex", "hex-vertical", "square")
_FORMS = ((8, True), (16, False), (8, False))


def random_camera(seed: int) -> tuple[Camera, float, float]:
    """A camera, its rotation and the tilt of its sensor [degrees]."""
    rng = np.random.default_rng(seed)
    rotation = rng.uniform(0, 3)
    tilt = rng.uniform(0, 0.5) * (seed % 5 != 4)
    way = rng.uniform(0, 2 * np.pi)
    camera = Camera.design(
        (1400, 1000),
        float(rng.uniform(15, 36)),
        _LATTICES[seed % 3],
        rotation,
        focus=float(rng.choice([-1, 1]) * rng.uniform(0.02, 0.25)),
        fill=float(rng.uniform(0.3, 0.95)),
        microimage_fill=float(rng.uniform(0.8, 1.1)),
    )
    x, y = np.radians(tilt) * np.array([np.cos(way), np.sin(way)])
    return camera.replace(sensor_tilt=(float(x), float(y))), rotation, tilt


def white_image(camera: Camera, seed: int) -> NDArray[np.uint8 | np.uint16]:
    """White image with photon noise; its brightest pixels have 0.9 of the largest value."""
    light = tracing.sensor(
        np.zeros((0, 23)), np.zeros((1, 4), np.float32), (1.0,) * 3, camera, 32, seed
    )[..., 3]
    bits, gamma = _FORMS[seed // 3 % 3]
    rng = np.random.default_rng(seed)
    return develop(
        light / np.percentile(light, 99.5), noise=(12000, 5), bits=bits, gamma=gamma, rng=rng
    )


def main(first: int, last: int) -> None:
    beyond: dict[str, list[float]] = {}
    for seed in range(first, last):
        camera, rotation, tilt = random_camera(seed)
        white = white_image(camera, seed)
        number = camera.mla_distance / camera.aperture
        try:
            try:
                found = lfcal.assess(white, f_number=number)
            except LightFieldError:
                # An overlap of bright lines is taken for no lens array, unless the pitch is hinted
                # at.
                hinted = lfcal.calibrate(white, "white", pitch=round(camera.pitch))
                found = lfcal.assess(white, calibration=hinted, f_number=number)
        except LightFieldError as error:
            print(f"{seed}: {error}", flush=True)
            continue
        aperture = camera.fill * camera.microlens_pitch / camera.pixel
        blur = aperture * abs(
            camera.spread - camera.sensor_distance / camera.microlens_focal_lengths[0]
        )
        step = float(np.linalg.norm(camera.basis, axis=1).min())
        truth = {
            "rotation": rotation,
            "tilt": tilt,
            "apertures": step - 2 * camera.microimage_radius,
            "distance": blur,
        }
        line = [f"{seed}: D {camera.pitch:.1f}, confidence {found.calibration.confidence:.2f}"]
        for name, true in truth.items():
            finding = found.findings[name]
            beyond.setdefault(name, []).append(abs(finding.value - true) / finding.error)
            line.append(f"{name} {finding.measured} (true {true:.4f})")
        print("; ".join(line), flush=True)
    for name, errors in beyond.items():
        within = [int((np.array(errors) < k).sum()) for k in (1, 2)]
        print(
            f"{name}: {within[0]} of {len(errors)} within one error, {within[1]} within two, "
            f"largest {max(errors):.1f}"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
