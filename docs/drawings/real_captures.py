"""Draw `docs/captures/*.jpg`, the pictures of `docs/real_captures.md`: `python
docs/drawings/real_captures.py FOLDER`.

Beside each other: a piece of the flat at 100 %, one pixel per microlens, and the picture in focus
everywhere, which are all that the commands of the page write, made small.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import lfcal
import lfrender

HEIGHT = 300  # of the pictures [px]
NAMES = {
    "Fujita2.png": "",
    "TempleBoatGiantR32.webp": "",
    "MiniGarden2.webp": "",
    "Square.jpg": "",
    "R5b.png": "R5b.white.png",
    "AntLeg.png": "AntLeg.white.png",
}


def _small(picture: NDArray, white: float) -> NDArray[np.uint8]:
    height, width = picture.shape[:2]
    size = (round(width * HEIGHT / height), HEIGHT)
    light = cv2.resize(
        picture.astype(np.float32), size, interpolation=cv2.INTER_AREA if height > HEIGHT else 0
    )
    light = np.clip(255 * light / white, 0, 255).astype(np.uint8)
    return np.repeat(
        light.reshape(*light.shape[:2], -1),
        1 if light.ndim == 3 and light.shape[2] == 3 else 3,
        axis=2,
    )


def draw(folder: Path, name: str, white: str) -> NDArray[np.uint8]:
    """The three pictures of a capture, (HEIGHT, W, 3)."""
    flat = lfcal.read_flat(folder / name)
    camera = lfcal.calibrate(lfcal.read_flat(folder / white) if white else flat)
    if camera.mosaic is not None:
        # White light does not tell red filters from blue ones.
        camera = dataclasses.replace(camera, mosaic="GBRG")
    depth = lfrender.analyze(flat, camera)
    picture = lfrender.render(flat, camera, depth).image
    middle = flat[flat.shape[0] // 2 - 150 :, flat.shape[1] // 2 - 150 :][:HEIGHT, :HEIGHT]
    level = 255.0 if picture.dtype == np.uint8 else float(np.percentile(picture, 99.8))
    shown = [
        _small(one, level) for one in (middle, lfrender.traditional(flat, camera).image, picture)
    ]
    gap = np.full((HEIGHT, 6, 3), 255, np.uint8)
    return np.hstack([shown[0], gap, shown[1], gap, shown[2]])


if __name__ == "__main__":
    place = Path(__file__).parents[1] / "captures"
    place.mkdir(exist_ok=True)
    for one, its_white in NAMES.items():
        bgr = draw(Path(sys.argv[1]), one, its_white)[:, :, ::-1]
        cv2.imwrite(str(place / f"{Path(one).stem}.jpg"), bgr, [cv2.IMWRITE_JPEG_QUALITY, 85])
