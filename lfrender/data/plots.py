"""Flats, cameras, depth maps and pictures as layers of napari."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lfcal import Calibration
from lfcal.runtime.errors import CAMERA_ADVICE, check_type

from ..runtime.types import Entries
from .depth_map import DEPTH_ADVICE, DepthMap
from .rendering import PICTURE_ADVICE, Rendering

__all__ = ["napari_layers"]


def napari_layers(
    flat: ArrayLike | None = None,
    calibration: Calibration | None = None,
    depth: DepthMap | None = None,
    rendering: Rendering | None = None,
) -> list[tuple[Any, Entries, str]]:
    """Layers of napari, one for each given argument, in coordinates of the flat (`y, x`).

    Add them by `for layer in napari_layers(...):
    viewer.add_layer(napari.layers.Layer.create(*layer))`.

    `flat` is (H, W) or (H, W, 3); the centres of `calibration` become points, the magnification of
    `depth` over the scene an image. Returns layer data tuples, (data, keywords, type); napari
    itself need not be installed.

    Examples
    --------
    >>> import lfrender
    >>> [kind for _, _, kind in napari_layers(*lfrender.data.example())]
    ['image', 'image', 'points']
    """
    layers: list[tuple[Any, Entries, str]] = []
    if flat is not None:
        pixels = np.asarray(flat)
        layers.append((pixels, {"name": "flat", "rgb": pixels.ndim == 3}, "image"))
    if rendering is not None:
        check_type(rendering, Rendering, "rendering", PICTURE_ADVICE)
        image = np.squeeze(rendering.image)
        place = {
            "scale": rendering.affine[[1, 0], [1, 0]],
            "translate": rendering.affine[[1, 0], 2],
        }
        layers.append((image, {"name": "rendering", "rgb": image.ndim == 3, **place}, "image"))
    if depth is not None:
        check_type(depth, DepthMap, "depth", DEPTH_ADVICE)
        (shown, *limits), surface = depth.clipped_magnification(), depth.surface
        place = {"scale": np.full(2, surface.spacing), "translate": np.array(surface.first[::-1])}
        looks = {"colormap": "turbo", "contrast_limits": tuple(limits), "opacity": 0.5}
        layers.append((shown, {"name": "magnification", **looks, **place}, "image"))
    if calibration is not None:
        check_type(calibration, Calibration, "calibration", CAMERA_ADVICE)
        look = {"size": 3, "face_color": "cyan", "name": "centres"}
        layers.append((calibration.lattice.centres()[:, ::-1], look, "points"))
    return layers
