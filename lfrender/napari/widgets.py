"""Functions that napari makes widgets of: calibrate, analyze, render.

Annotations name napari's types without importing it: magicgui resolves these strings, and these
alone, so that all other annotations have to be types.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, FlatError, load
from lfcal import calibrate as find_camera

from ..data.plots import napari_layers
from ..depth.analyze import analyze as find_depth
from ..flat.demosaicing import demosaic
from ..rendering.render import render as draw
from ..runtime.choices import Preset

if TYPE_CHECKING:
    import napari.types

__all__ = ["analyze", "calibrate", "render"]


def calibrate(
    flat: "napari.types.ImageData",
    kind: Literal["auto", "white", "scene"] = "auto",
    save_to: Path = Path(),
) -> list["napari.types.LayerDataTuple"]:
    """The centres of the microimages as points; `save_to` is a camera file to write."""
    camera = find_camera(_pixels(flat), kind=kind)
    if save_to.suffix:
        camera.save(save_to)
    return napari_layers(calibration=camera)


def analyze(
    flat: "napari.types.ImageData",
    camera: Path = Path(),
    preset: Preset = "balanced",
    save_to: Path = Path(),
) -> list["napari.types.LayerDataTuple"]:
    """The magnification over the scene; without a camera file the flat is calibrated."""
    pixels, calibration = _prepare(flat, camera)
    depth = find_depth(pixels, calibration, preset)
    if save_to.suffix:
        depth.save(save_to)
    return napari_layers(depth=depth)


def render(
    flat: "napari.types.ImageData",
    camera: Path = Path(),
    preset: Preset = "balanced",
    pixels_per_pitch: float = 0.0,
) -> list["napari.types.LayerDataTuple"]:
    """The all-in-focus picture and its depth; 0 pixels per pitch: full resolution."""
    pixels, calibration = _prepare(flat, camera)
    depth = find_depth(pixels, calibration, preset)
    picture = draw(pixels, calibration, depth, scale=pixels_per_pitch or None)
    return napari_layers(depth=depth, rendering=picture)


def _pixels(flat: NDArray | None) -> NDArray:
    if flat is None:
        raise FlatError("choose a layer with a flat first")
    pixels = np.asarray(flat)
    if pixels.ndim == 3 and pixels.shape[2] == 4:
        pixels = pixels[..., :3]
    return np.ascontiguousarray(pixels)


def _prepare(flat: NDArray | None, camera: Path) -> tuple[NDArray, Calibration]:
    """The flat in colour, and its camera."""
    pixels = _pixels(flat)
    size = pixels.shape[1], pixels.shape[0]
    calibration = load(camera, size) if camera.suffix else find_camera(pixels)
    if calibration.mosaic is not None and pixels.ndim == 2:
        pixels = demosaic(pixels, calibration)
    return pixels, calibration
