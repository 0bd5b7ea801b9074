"""MTF50 on a slanted edge, picture beside reference: `python -m benchmarks.mtf`.

The frequency at which contrast has fallen to a half [cycles per pixel of the flat], by the method of the slanted edge
(ISO 12233): pixels are sorted by their distance from the edge into quarters of a pixel, differentiated, transformed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import lfrender
from data_synth import SCENES, Camera, simulate
from data_synth.metrics import resample

__all__ = ["mtf50"]

_ANGLE = 5.0
_RATIO = -0.3
_FINER = 4  # bins per pixel


def mtf50(image: NDArray[Any]) -> float:
    """[cycles per pixel] where the contrast of the edge nearest to the middle of `image` (h, w) falls to a half.

    The edge is nearly vertical, and every row crosses it within a fifth of the width of the middle.
    """
    grey = np.asarray(image, float)
    height, width = grey.shape
    reach = width // 5
    columns = np.arange(width // 2 - 2 * reach, width // 2 + 2 * reach)
    step = np.abs(np.gradient(grey, axis=1))[:, width // 2 - reach : width // 2 + reach]
    weight = step**2
    at = (weight * np.arange(width // 2 - reach, width // 2 + reach)).sum(1) / weight.sum(1)
    slope, first = np.polyfit(np.arange(height), at, 1)
    rows = np.arange(height)[:, None]
    distance = (columns - (slope * rows + first)) / np.hypot(1, slope)
    number = np.floor(distance * _FINER).astype(int)
    number -= number.min()
    total = np.bincount(number.ravel(), grey[:, columns].ravel())
    count = np.maximum(np.bincount(number.ravel()), 1)
    line = np.diff(total / count)
    middle = int(np.argmax(np.abs(line)))
    half = min(middle, len(line) - 1 - middle, reach * _FINER)
    line = line[middle - half : middle + half + 1] * np.hanning(2 * half + 3)[1:-1]
    contrast = np.abs(np.fft.rfft(line, 4096))
    contrast /= contrast[0]
    below = int(np.argmax(contrast < 0.5))
    share = (contrast[below - 1] - 0.5) / (contrast[below - 1] - contrast[below])
    return float((below - 1 + share) * _FINER / 4096)


def _main() -> None:
    print("| aperture / pitch | off | natural | reference |\n|---|---|---|---|")
    for fill in (0.16, 0.22, 0.28):
        camera = Camera.design(size=(720, 560), pitch=35.0, fill=fill)
        chart, scene = (SCENES[name](camera, ratio=_RATIO) for name in ("edge", "plane"))
        shot, plain = (simulate(one, camera, samples=96, seed=3, noise=(8000, 5)) for one in (chart, scene))
        truth = shot.truth
        # Depth and blur are those of a scene: a chart of edges alone resolves few lenses.
        depth = lfrender.analyze(plain.flat, truth.calibration)
        found = []
        for detail in ("off", "natural"):
            picture = _draw(shot.flat, plain.flat, truth.calibration, depth, detail == "natural")
            found.append(_middle(picture.image))
        wanted, _ = resample(truth.reference, truth.reference_affine, picture.image.shape[:2], picture.affine)
        found.append(_middle(wanted))
        per_flat = picture.scale / (abs(_RATIO) * camera.pitch)
        print(f"| {fill} | {' | '.join(f'{one * per_flat:.3f}' for one in found)} |", flush=True)


def _draw(flat: Any, scene: Any, camera: Any, depth: lfrender.DepthMap, natural: bool) -> lfrender.Rendering:
    before = lfrender.render(scene, camera, depth, detail="natural" if natural else "off")
    drawn = lfrender.render(flat, camera, depth, previous=(np.zeros_like(flat), depth, before))
    return drawn


def _middle(image: NDArray[Any]) -> float:
    """MTF50 of the edge that is nearest to the middle, away from the border."""
    grey = np.asarray(image, float).mean(2)
    height, width = grey.shape
    part = grey[height // 2 - 20 : height // 2 + 20]
    change = np.abs(np.gradient(part.mean(0)))
    change[: width // 4] = change[-width // 4 :] = 0
    at = int(np.argmax(change))
    return mtf50(part[:, at - 20 : at + 21])


if __name__ == "__main__":
    _main()
