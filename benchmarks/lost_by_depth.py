"""Loss of PSNR by wrong depth: `python -m benchmarks.lost_by_depth FIRST LAST [--square]`.

Random houses and clutter (scenes with depth edges) of `benchmarks.random_scenes`, with 256 rays a
pixel, are drawn with the depth of `balanced` and with the true depth of every scene point, at 0.15
and 0.3 pitches per pixel. Both are compared with the ray-traced picture, at places with a
resolvable depth. With `--square` every seed is a house or clutter before square lenses of 30 to 80
px.

Each scene has a second line about the finer picture: which share of the loss lies in the worst 0.1
and 1 % of its pixels; where the depth is too far, so that a thing is missed; and where it is too
near, so that a gap is filled.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import lfcal
import lfrender
from data_synth import Capture
from data_synth.metrics import compare_pictures, resample

from .random_scenes import draw
from .true_surface import with_true_surface

__all__ = ["Loss", "main", "measure_loss"]

_SCALES = (0.15, 0.3)  # [pitch] per pixel
_RESOLVABLE = 0.75  # [pitch]
# [pitch] depths that are as wrong miss a thing or fill a gap.
_WRONG = 0.06
_SQUARE_PITCHES = (30.0, 80.0)  # [px]
_RAYS = 256


@dataclass(frozen=True)
class Loss:
    """What wrong depth costs a picture.

    Parameters
    ----------
    psnr : float [dB]
        PSNR with the true depth less that with the depth that was found.
    worst : (2,) float
        Share of the further squared error, where there is some, that lies in the worst 0.1 and 1 %
        of the pixels.
    missed, filled : float
        The same where the depth is too far and too near.
    """

    psnr: float
    worst: tuple[float, float]
    missed: float
    filled: float


def measure_loss(
    depth: lfrender.DepthMap, capture: Capture, camera: lfcal.Calibration, scale: float
) -> Loss:
    """Loss of a picture of `scale` pitches per pixel that is drawn with this depth."""
    truth = capture.truth
    pitch = camera.lattice.pitch
    true = with_true_surface(depth, truth.reference_patch_size, truth.reference_affine)
    found, best = (
        lfrender.render(capture.flat, camera, one, scale=scale * pitch, detail="off")
        for one in (depth, true)
    )
    shape = found.image.shape[:2]
    wanted, inside = resample(truth.reference, truth.reference_affine, shape, found.affine)
    beyond = ~(np.abs(truth.reference_patch_size) < _RESOLVABLE * pitch)
    lost, _ = resample(beyond * 1.0, truth.reference_affine, shape, found.affine)
    border = int(np.ceil(found.scale))
    inner = np.zeros(shape, bool)
    inner[border:-border, border:-border] = True
    where = inside & inner & found.valid & (lost == 0)

    quality = []
    errors = []
    for one in (found, best):
        image = one.image / np.float64(np.iinfo(one.image.dtype).max)
        quality.append(compare_pictures(image, wanted, where))
        difference = (image.reshape(*shape, -1) * quality[-1].gain) - wanted.reshape(*shape, -1)
        errors.append((difference**2).mean(-1)[where])
    further = errors[0] - errors[1]
    total = max(float(further[further > 0].sum()), 1e-12)
    descending = np.sort(further)[::-1]
    worst = [descending[: max(1, int(share * len(further)))].sum() for share in (0.001, 0.01)]

    behind = (nearness(depth, found.affine, shape) - nearness(true, found.affine, shape))[where]
    missed = further[behind < -_WRONG * pitch].sum()
    filled = further[behind > _WRONG * pitch].sum()
    return Loss(
        quality[1].psnr - quality[0].psnr,
        (float(worst[0] / total), float(worst[1] / total)),
        float(missed / total),
        float(filled / total),
    )


def nearness(
    depth: lfrender.DepthMap, affine: NDArray[np.float64], shape: tuple[int, ...]
) -> NDArray[np.float32]:
    """(h, w) [px] a number that rises towards the camera, for each pixel of a picture: telescopic
    patch sizes lie behind binocular ones.
    """
    surface = depth.surface
    v, u = np.mgrid[: shape[0], : shape[1]]
    x = affine[0, 0] * u + affine[0, 1] * v + affine[0, 2]
    y = affine[1, 0] * u + affine[1, 1] * v + affine[1, 2]
    rows, columns = surface.patch_size.shape
    column = np.clip(np.rint((x - surface.first[0]) / surface.spacing).astype(int), 0, columns - 1)
    row = np.clip(np.rint((y - surface.first[1]) / surface.spacing).astype(int), 0, rows - 1)
    s = surface.patch_size[row, column]
    return np.where(s > 0, s, s + 2 * depth.pitch)


def _describe(name: str, losses: list[Loss]) -> str:
    first = losses[0]
    return (
        f"{name}: {' / '.join(f'{loss.psnr:.2f}' for loss in losses)} dB\n"
        f"    of it in the worst 0.1 %: {first.worst[0]:.0%}, 1 %: {first.worst[1]:.0%}; "
        f"missed things {first.missed:.0%}, filled gaps {first.filled:.0%}"
    )


def main() -> None:
    """Print two lines for each scene, the mean and the worst."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int)
    parser.add_argument("--square", action="store_true")
    arguments = parser.parse_args()
    every = []
    for seed in range(arguments.first, arguments.last + 1):
        if arguments.square:
            name, capture = draw(seed, _RAYS, _SQUARE_PITCHES, ("square",), ("house", "clutter"))
        else:
            name, capture = draw(seed, _RAYS)
        if not name.startswith(("house", "clutter")):
            continue
        camera = lfcal.calibrate(capture.flat)
        depth = lfrender.analyze(capture.flat, camera)
        losses = [measure_loss(depth, capture, camera, scale) for scale in _SCALES]
        every.append([loss.psnr for loss in losses])
        print(f"{seed} {_describe(name, losses)}", flush=True)
    mean = np.mean(every, 0)
    worst = np.max(every, 0)
    print(f"mean {mean[0]:.2f} / {mean[1]:.2f} dB, worst {worst[0]:.2f} / {worst[1]:.2f} dB")


if __name__ == "__main__":
    main()
