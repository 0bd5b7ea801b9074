"""Draw `docs/overview.jpg`, the picture at the head of README: `python
docs/drawings/readme_picture.py` (40 s).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

import lfcal
import lfrender
from data_synth import SCENES, Camera, simulate
from lfrender.data.dense_depth import dense_depth
from lfrender.output.depth_picture import colour_scale

_PANEL = (600, 450)
_GAP = 8
# Part of the flat that is shown enlarged [px]: left, top, width, height.
_DETAIL = (760, 452, 150, 112)


def main() -> None:
    """Simulate a house behind branches and put flat, traditional picture, lfrender's picture and
    depth side by side.
    """
    camera = Camera.design(size=(2000, 1500), pitch=23.2, rotation=1.3)
    capture = simulate(
        SCENES["house"](camera, seed=1), camera, samples=48, seed=1, noise=(12000, 5)
    )
    found = lfcal.calibrate(capture.flat)
    depth = lfrender.analyze(capture.flat, found)
    picture = lfrender.render(capture.flat, found, depth)
    traditional = lfrender.traditional(capture.flat, found)
    size = dense_depth(depth, picture.scale).patch_size
    panels = [
        _with_detail(capture.flat),
        _panel(traditional.image, "traditional: one pixel per microlens", Image.Resampling.NEAREST),
        _panel(picture.image, "lfrender: sharp near and far"),
        _panel(_nearness(size, found.lattice.pitch), "depth: far dark, near bright"),
    ]
    width, height = _PANEL
    whole = Image.new("RGB", (2 * width + _GAP, 2 * height + _GAP), "white")
    for number, panel in enumerate(panels):
        whole.paste(panel, ((number % 2) * (width + _GAP), (number // 2) * (height + _GAP)))
    whole.save(Path(__file__).parents[1] / "overview.jpg", quality=88)


def _panel(
    pixels: NDArray[np.uint8], text: str, method: Image.Resampling = Image.Resampling.LANCZOS
) -> Image.Image:
    """Pixels at the size of a panel, with a line of text at its lower left."""
    panel = Image.fromarray(np.ascontiguousarray(pixels)).resize(_PANEL, method)
    draw = ImageDraw.Draw(panel, "RGBA")
    font = ImageFont.load_default(24)
    box = draw.textbbox((14, _PANEL[1] - 40), text, font=font)
    draw.rectangle((box[0] - 8, box[1] - 6, box[2] + 8, box[3] + 6), fill=(0, 0, 0, 190))
    draw.text((14, _PANEL[1] - 40), text, fill="white", font=font)
    return panel


def _with_detail(flat: NDArray[np.uint8]) -> Image.Image:
    """The flat with some of its microimages enlarged in a corner."""
    panel = _panel(flat, "raw flat")
    left, top, width, height = _DETAIL
    part = Image.fromarray(flat[top : top + height, left : left + width]).resize(
        (300, 224), Image.Resampling.LANCZOS
    )
    frame = Image.new("RGB", (306, 230), "white")
    frame.paste(part, (3, 3))
    panel.paste(frame, (_PANEL[0] - 306, _PANEL[1] - 230))
    return panel


def _nearness(patch_size: NDArray[np.floating], pitch: float) -> NDArray[np.uint8]:
    """Signed patch sizes [px] as colours: far is dark. `-D / s` grows with nearness over both
    modes.
    """
    value = -pitch / np.where(np.abs(patch_size) < 0.05 * pitch, 0.05 * pitch, patch_size)
    low, high = np.percentile(value, (1, 99))
    share = np.clip((value - low) / (high - low), 0, 1)
    return colour_scale("viridis")[np.rint(40 + 215 * share).astype(int)]


if __name__ == "__main__":
    main()
