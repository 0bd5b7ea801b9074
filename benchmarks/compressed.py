"""Detail of captures as JPEG and video: `python -m benchmarks.compressed [../shared/captures]`.

Camera and depth are those of the capture as it is. Pictures of the flat as JPEG of quality 90, 75 and 50, and of the
first frame of a video of it, are compared with the picture of the capture of the same `detail`: mean square error
[levels of 255] in blank places, and beside the strongest edges, where compression leaves noise.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

import lfcal
import lfrender

_CAPTURES = ("Fujita2.png", "Boys2.webp", "MiniGarden2.webp", "TempleBoatGiantR32.webp", "R42_crop.png")
_MODES: tuple[Literal["off", "natural"], ...] = ("off", "natural")
_HINTS = {"R42_crop.png": 34.5}  # [px] pitch
_WINDOW = 9  # [px] in which the contrast of a place is measured


def _coded(path: Path, flat: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    for quality in (90, 75, 50):
        coded = cv2.imencode(".jpg", flat[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        yield f"JPEG {quality}", np.ascontiguousarray(np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR))[..., ::-1])
    if path.with_suffix(".vvc").exists():
        yield "first frame of the video", lfcal.read_flat(path.with_suffix(".vvc"), 0)


def _classes(picture: lfrender.Rendering) -> list[NDArray[np.bool_]]:
    """Masks: blank places, and those beside edges."""
    grey, window = picture.image.mean(2).astype(np.float32), (_WINDOW, _WINDOW)
    contrast = np.sqrt(np.maximum(cv2.blur(grey * grey, window) - cv2.blur(grey, window) ** 2, 0))
    low, middle, high = np.quantile(contrast[picture.valid], (0.3, 0.6, 0.9))
    near = cv2.dilate((contrast > high).astype(np.uint8), np.ones(window, np.uint8)) > 0
    return [picture.valid & (contrast < low) & ~near, picture.valid & (contrast < middle) & near]


def _levels(picture: lfrender.Rendering) -> NDArray[Any]:
    return picture.image * (255 / np.iinfo(picture.image.dtype).max)


def _main() -> None:
    folder = Path(sys.argv[1] if sys.argv[1:] else "../shared/captures")
    print("| capture | stored as | detail | blank | beside edges |\n|---|---|---|---|---|")
    for path in (folder / name for name in _CAPTURES):
        flat = lfcal.read_flat(path)
        camera = lfcal.calibrate(flat, pitch=_HINTS.get(path.name))
        depth = lfrender.analyze(flat, camera)
        wanted = {mode: _levels(lfrender.render(flat, camera, depth, detail=mode)) for mode in _MODES}
        masks = _classes(lfrender.render(flat, camera, depth, detail="off"))
        for name, coded in _coded(path, flat):
            # Videos are encoded for display.
            known = replace(camera, encoded=True)
            for mode in _MODES:
                error = _levels(lfrender.render(coded, known, depth, detail=mode)) - wanted[mode]
                cells = " | ".join(f"{np.mean(error[mask] ** 2):.2f}" for mask in masks)
                print(f"| {path.stem} | {name} | {mode} | {cells} |", flush=True)


if __name__ == "__main__":
    _main()
