"""Depth of random scenes of random cameras: `python -m benchmarks.random_scenes [FIRST LAST
[SAMPLES]]`.

Each seed draws a camera (lattice, pitch, rotation, lens types, noise, bits) and a scene of
`data_synth`. Only the flat is given; the lattice is calibrated from it. Modes, patch sizes and
edges are judged as in `benchmarks.truth_flats`. With few samples (rays per pixel) the ray tracer
adds noise, which in fine clutter is stronger than the noise of the camera.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

import lfcal
import lfrender
from data_synth import SCENES, Camera, Capture, simulate
from data_synth.camera import LATTICES

from .depth_edges import edge_share

__all__ = ["DepthErrors", "draw", "judge", "main"]

_SEEDS = (0, 20)
# Pitches [px], and how many of them the flat is wide.
_PITCHES = (11.0, 60.0)
_ACROSS = (28.0, 46.0)
_LARGEST_ROTATION = 25.0
# Share of the hexagonal cameras with three lens types, and where these are focused [s / D].
_THREE_TYPES = 0.3
_FOCUS = (0.08, 0.2, 0.32)
_FULL_WELLS = (800.0, 20000.0)
_READ = (2.0, 6.0)
_SAMPLES = 256
# Lenses that show less contrast are not judged; a lens is the one of the truth that is nearer than
# this [pitches].
_CONTRAST = 0.03
_SAME = 0.25
# Lenses farther than this [share of the pitch] from the median of a scene, so many at least, are
# judged apart.
_APART = 0.03
_FEWEST = 10


@dataclass(frozen=True)
class DepthErrors:
    """Errors of an analysis over textured lenses that see one resolvable depth.

    Parameters
    ----------
    centres : float [px]
        RMS error of the calibrated centres.
    right, wrong : float
        Share of the lenses in the right mode, and in the opposite one.
    median, most : float [px]
        Median and 95th percentile of the error of the patch size.
    within : float
        Share of the lenses within their standard error.
    before, before_within : float [px], float
        Median error of the lenses that do not show the depth of the most, and share of them within
        their standard error; NaN where these are few.
    edges : float
        Share of the depth edges that are right to one pixel of the traditional picture.
    """

    centres: float
    right: float
    wrong: float
    median: float
    most: float
    within: float
    before: float
    before_within: float
    edges: float

    @property
    def wanted(self) -> bool:
        """Whether all errors are within the limits for every scene."""
        return (
            self.right >= 0.995 and self.median <= 0.02 and self.most <= 0.3 and self.edges >= 0.9
        )


def draw(
    seed: int,
    samples: int = _SAMPLES,
    pitches: tuple[float, float] = _PITCHES,
    lattices: Sequence[str] = tuple(LATTICES),
    scenes: Sequence[str] = ("house", "plane", "slope", "clutter"),
) -> tuple[str, Capture]:
    """Description and capture of a random scene; `samples` is the number of rays per pixel.

    The pitch [px] lies between two `pitches`; lattice and scene are some of the given ones.
    """
    rng = np.random.default_rng(seed)
    pitch = float(np.exp(rng.uniform(*np.log(pitches))))
    width = int(pitch * rng.uniform(*_ACROSS))
    lattice = str(rng.choice(list(lattices)))
    three = lattice.startswith("hex") and rng.random() < _THREE_TYPES
    turned = float(rng.uniform(-_LARGEST_ROTATION, _LARGEST_ROTATION))
    camera = Camera.design(
        (width, int(0.75 * width)), pitch, lattice, turned, focus=_FOCUS if three else 0.04
    )
    name = str(rng.choice(list(scenes)))
    options: dict[str, float] = {}
    if name == "plane":
        options["ratio"] = float(rng.choice([rng.uniform(-0.6, -0.12), rng.uniform(0.12, 0.4)]))
    elif name == "slope":
        options["left"], options["right"] = (
            float(v) for v in np.sort(rng.uniform(-0.55, -0.12, 2))
        )
    noise = float(np.exp(rng.uniform(*np.log(_FULL_WELLS)))), float(rng.uniform(*_READ))
    gamma = bool(rng.random() < 0.7)
    bits = 8 if gamma else int(rng.choice([8, 16]))
    scene = SCENES[name](camera, seed=seed, **options)
    capture = simulate(
        scene, camera, samples=samples, seed=seed, noise=noise, gamma=gamma, bits=bits
    )
    types = ", 3 types" if three else ""
    return (
        f"{name}, {lattice}{types}, {pitch:.1f} px, {turned:+.0f} degrees, {noise[0]:.0f} e, "
        f"{bits} bits",
        capture,
    )


def judge(capture: Capture) -> DepthErrors:
    """Calibrate the flat, analyse it with `balanced`, and compare with the truth."""
    truth = capture.truth
    camera = lfcal.calibrate(capture.flat)
    depth = lfrender.analyze(capture.flat, camera)
    apart, near = cKDTree(truth.calibration.lattice.centres()).query(camera.lattice.centres())
    known = apart < _SAME * truth.calibration.lattice.pitch
    judged = ((truth.mode != 0) & ~truth.mixed & (truth.contrast > _CONTRAST))[near] & known
    mode = depth.mode[judged]
    wanted = truth.mode[near][judged]
    error = np.abs(depth.patch_size - truth.patch_size[near])[judged]
    # Lenses left unresolved count among the modes alone.
    measured = np.isfinite(error)
    within = error <= depth.standard_error[judged]
    away = np.abs(truth.patch_size[near][judged] - np.median(truth.patch_size[near][judged]))
    before = measured & (away > _APART * depth.pitch)
    many = before.sum() >= _FEWEST
    return DepthErrors(
        centres=float(np.sqrt((apart[known] ** 2).mean())),
        right=float((mode == wanted).mean()),
        wrong=float((mode == -wanted).mean()),
        median=float(np.nanmedian(error)),
        most=float(np.nanquantile(error, 0.95)),
        within=float(within[measured].mean()),
        before=float(np.median(error[before])) if many else float("nan"),
        before_within=float(within[before].mean()) if many else float("nan"),
        edges=edge_share(depth, truth.reference_patch_size, truth.reference_affine),
    )


def main(arguments: list[str]) -> None:
    first, last, samples = (*(int(v) for v in arguments), *(*_SEEDS, _SAMPLES)[len(arguments) :])
    every = []
    for seed in range(first, last):
        described, capture = draw(seed, samples)
        found = judge(capture)
        every.append(found)
        print(
            f"{seed:3d} {described:62s} centres {found.centres:.4f} px  modes {found.right:.4f} "
            f"wrong {found.wrong:.4f}"
            f"  s median {found.median:.4f} 95 % {found.most:.3f} px  within its error "
            f"{found.within:.2f}"
            f"  before it {found.before:.4f} px {found.before_within:.2f}  edges {found.edges:.3f}",
            flush=True,
        )
    means = [
        np.mean([getattr(found, name) for found in every]) for name in ("right", "wrong", "within")
    ]
    print(
        f"{sum(found.wanted for found in every)} of {len(every)} scenes as wanted;"
        " means: modes {:.5f} wrong {:.5f} within {:.3f}".format(*means)
    )


if __name__ == "__main__":
    main(sys.argv[1:])
