"""Captures of random cameras with square apertures, lenses of three radii, or colour filters."""

from __future__ import annotations

import numpy as np

from data_synth import SCENES, Camera, Capture, simulate

__all__ = ["draw_kind"]

_SAMPLES = 8  # rays per pixel


def draw_kind(seed: int) -> tuple[str, Capture]:
    """Description and capture of a camera of one of the kinds, in turn, before a random scene."""
    rng = np.random.default_rng([seed, 52])
    kind = ("square aperture", "three radii", "mosaic")[seed % 3]
    pitch = float(np.exp(rng.uniform(*np.log((12.0, 60.0)))))
    width = int(pitch * rng.uniform(24, 46))
    size = (width, int(0.75 * width))
    turned = float(rng.uniform(-25, 25))
    if kind == "square aperture":
        camera = Camera.design(
            size, pitch, "square", turned, microimage_fill=float(rng.uniform(0.82, 0.97))
        )
        camera = camera.replace(square_aperture=True)
    else:
        lattice = str(rng.choice(["hex", "hex-vertical"]))
        camera = Camera.design(size, pitch, lattice, turned, focus=(0.08, 0.2, 0.32))
        if kind == "three radii":
            shares = rng.permutation([1.0, *rng.uniform(0.86, 1.0, 2)])
            camera = camera.replace(
                type_apertures=tuple(shares.tolist()), stray=float(rng.uniform(0, 0.3))
            )
        else:
            mosaic = str(rng.choice(["RGGB", "BGGR", "GRBG", "GBRG"]))
            camera = camera.replace(mosaic=mosaic, filters=tuple(rng.uniform(0.5, 1.0, 3).tolist()))
    name = str(rng.choice(["house", "plane", "slope", "clutter"]))
    noise = float(np.exp(rng.uniform(*np.log((800.0, 20000.0))))), float(rng.uniform(2.0, 6.0))
    gamma = bool(rng.random() < 0.7)
    capture = simulate(
        SCENES[name](camera, seed=seed),
        camera,
        samples=_SAMPLES,
        seed=seed,
        noise=noise,
        gamma=gamma,
    )
    return f"{name}, {kind}, {pitch:.1f} px, {turned:+.0f} degrees, {noise[0]:.0f} e", capture
