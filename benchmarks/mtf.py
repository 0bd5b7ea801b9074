"""Resolution of pictures: `python -m benchmarks.mtf [plot.png]`.

MTF50, the frequency at which contrast has fallen to a half [cycles per pixel of the flat], by the
method of the slanted edge (ISO 12233): pixels are sorted by their distance from the edge into
quarters of a pixel, differentiated, transformed. Then the contrast of a Siemens star by frequency,
along circles about its middle. Picture with `detail="off"` and `"natural"` beside the flat (pixels
of single lenses, laid side by side) and the reference.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

import lfrender
from data_synth import SCENES, Camera, simulate
from data_synth.metrics import resample

__all__ = ["mtf50", "star_contrast"]

_ANGLE = 5.0
_RATIO = -0.3
_PLOTTED = 0.22  # aperture over pitch of the star and the plot
_SPOKES = 36
_FINER = 4  # bins per pixel


def mtf50(image: NDArray[Any]) -> float:
    """[cycles per pixel] where the contrast of the edge nearest to the middle of `image` (h, w)
    falls to a half.

    The edge is nearly vertical, and every row crosses it within a fifth of the width of the middle.
    """
    frequency, contrast = _edge_contrast(image)
    below = int(np.argmax(contrast < 0.5))
    share = (contrast[below - 1] - 0.5) / (contrast[below - 1] - contrast[below])
    return float(frequency[below - 1] + share * (frequency[1] - frequency[0]))


def _edge_contrast(image: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Frequencies [cycles per pixel] and the contrast at each."""
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
    return np.arange(len(contrast)) * _FINER / 4096, contrast / contrast[0]


def star_contrast(
    image: NDArray[Any], spokes: int, radii: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Amplitude over mean of a star about the middle of `image` (h, w), along circles of `radii`
    [px].
    """
    from scipy.ndimage import map_coordinates

    grey = np.asarray(image, float)
    turn = np.arange(32 * spokes) * 2 * np.pi / (32 * spokes)
    middle = (np.array(grey.shape) - 1) / 2
    places = (
        middle[:, None, None] + radii[:, None] * np.stack([np.sin(turn), np.cos(turn)])[:, None]
    )
    seen = map_coordinates(grey, places, order=1)
    return np.asarray(2 * np.abs((seen * np.exp(-1j * spokes * turn)).mean(1)) / seen.mean(1))


def _main() -> None:
    print("| aperture / pitch | off | natural | flat | reference |\n|---|---|---|---|---|")
    curves = {}
    for fill in (0.16, 0.22, 0.28):
        edge, per_flat = _pictures("edge", fill)
        parts = {name: _middle(image) for name, image in edge.items()}
        print(
            f"| {fill} | "
            f"{' | '.join(f'{mtf50(part) * per_flat[n]:.3f}' for n, part in parts.items())} |",
            flush=True,
        )
        if fill == _PLOTTED:
            curves = {
                n: (f * per_flat[n], c)
                for n, part in parts.items()
                for f, c in [_edge_contrast(part)]
            }
    star, per_flat = _pictures("star", _PLOTTED)
    wanted = np.array([0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4])
    print("\n| cycles per pixel | off | natural | flat | reference |\n|---|---|---|---|---|")
    rows = [
        star_contrast(
            np.asarray(image, float).mean(2), _SPOKES, _SPOKES * per_flat[n] / (2 * np.pi * wanted)
        )
        for n, image in star.items()
    ]
    for frequency, contrasts in zip(wanted, np.transpose(rows) / rows[-1][0], strict=True):
        print(f"| {frequency:.2f} | {' | '.join(f'{one:.2f}' for one in contrasts)} |")
    if sys.argv[1:]:
        _plot(curves, sys.argv[1])


def _pictures(chart: str, fill: float) -> tuple[dict[str, NDArray[Any]], dict[str, float]]:
    """Pictures of a chart, and the pixels of each per pixel of the flat."""
    camera = Camera.design(size=(720, 560), pitch=35.0, fill=fill)
    # Depth and blur are those of a scene: a chart of edges alone resolves few lenses.
    shot, scene = (
        simulate(SCENES[name](camera, ratio=_RATIO), camera, samples=96, seed=3, noise=(8000, 5))
        for name in (chart, "plane")
    )
    truth = shot.truth
    depth = lfrender.analyze(scene.flat, truth.calibration)
    images = {}
    for detail in ("off", "natural"):
        before = lfrender.render(
            scene.flat, truth.calibration, depth, detail="off" if detail == "off" else "natural"
        )
        blank = np.zeros_like(shot.flat)
        picture = lfrender.render(
            shot.flat, truth.calibration, depth, previous=(blank, depth, before)
        )
        images[detail] = picture.image
    single = lfrender.render(shot.flat, truth.calibration, patch_size=_RATIO * camera.pitch)
    images["flat"] = single.image
    images["reference"], _ = resample(
        truth.reference, truth.reference_affine, picture.image.shape[:2], picture.affine
    )
    per_flat = picture.scale / (abs(_RATIO) * camera.pitch)
    return images, dict.fromkeys(images, per_flat) | {"flat": 1.0}


def _plot(curves: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]], path: str) -> None:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
    for name, (frequency, contrast) in curves.items():
        axes.plot(frequency[frequency < 0.6], contrast[frequency < 0.6], label=name)
    axes.axhline(0.5, color="0.8", zorder=0)
    axes.set(xlabel="cycles per pixel of the flat", ylabel="contrast", xlim=(0, 0.6), ylim=(0, 1.1))
    axes.legend()
    figure.savefig(path, dpi=110)


def _middle(image: NDArray[Any]) -> NDArray[np.float64]:
    """Part about the edge that is nearest to the middle, away from the border."""
    grey = np.asarray(image, float).mean(2)
    height, width = grey.shape
    part = grey[height // 2 - 20 : height // 2 + 20]
    change = np.abs(np.gradient(part.mean(0)))
    change[: width // 4] = change[-width // 4 :] = 0
    at = int(np.argmax(change))
    return np.asarray(part[:, at - 20 : at + 21])


if __name__ == "__main__":
    _main()
