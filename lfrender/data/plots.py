"""Depth maps and pictures on Matplotlib axes, and in napari."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal import Calibration

if TYPE_CHECKING:
    from .depth_map import DepthMap
    from .rendering import Rendering

__all__ = ["napari_layers", "plot_depth", "plot_rendering"]


def plot_depth(depth: DepthMap, ax: Any = None) -> Any:
    """`DepthMap.plot`."""
    from matplotlib.colors import LogNorm

    (shown, low, high), surface = _magnification(depth), depth.surface
    lens = depth.nearest_lens(shown.shape, surface.first, surface.spacing)
    if lens is not None:
        shown[depth.filled[lens]] = np.nan
    corner = np.array(surface.first) - surface.spacing / 2
    place = corner, corner + surface.spacing * np.array(shown.shape[::-1])
    drawn = _show(ax, shown, *place, "Magnification", norm=LogNorm(low, high), cmap="turbo", interpolation="nearest")
    # Grey as in the maps of `lfrender.output.depth_picture`.
    drawn.axes.set_facecolor(np.full(3, 150 / 255))
    bar = drawn.figure.colorbar(drawn, ax=drawn.axes, label="magnification M (grey: unresolved)")
    bar.set_ticks(np.geomspace(low, high, 5), labels=[f"{tick:.2g}" for tick in np.geomspace(low, high, 5)])
    bar.minorticks_off()
    return drawn.axes


def plot_rendering(rendering: Rendering, ax: Any = None) -> Any:
    """`Rendering.plot`."""
    image = rendering.image
    if image.dtype.kind == "u":
        image = image / np.float32(rendering.white or np.iinfo(image.dtype).max)
    height, width = image.shape[:2]
    place = rendering.affine @ [-0.5, -0.5, 1], rendering.affine @ [width - 0.5, height - 0.5, 1]
    look: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": 1}
    return _show(ax, np.clip(np.squeeze(image), 0, 1), *place, f"{rendering.scale:.1f} px per pitch", **look).axes


def _show(ax: Any, image: NDArray, first: NDArray, last: NDArray, title: str, **look: Any) -> Any:
    """A picture on Matplotlib axes between two corners of it in scene coordinates."""
    import matplotlib.pyplot as plt

    ax = ax or plt.gca()
    ax.set(xlabel="x [flat px]", ylabel="y [flat px]", title=title)
    return ax.imshow(image, extent=(first[0], last[0], last[1], first[1]), **look)


def napari_layers(
    flat: ArrayLike | None = None,
    calibration: Calibration | None = None,
    depth: DepthMap | None = None,
    rendering: Rendering | None = None,
) -> list[tuple[Any, dict[str, Any], str]]:
    """Layers of napari, one for each argument that is given, all in the coordinates of the flat, order `y, x`.

    Add them by `for layer in napari_layers(...): viewer.add_layer(napari.layers.Layer.create(*layer))`.

    `flat` is (H, W) or (H, W, 3); the centres of `calibration` become points, the magnification of `depth` over the
    scene an image. Returns layer data tuples, (data, keywords, type); napari itself need not be installed.

    Examples
    --------
    >>> import lfrender
    >>> [kind for _, _, kind in napari_layers(*lfrender.data.example())]
    ['image', 'image', 'points']
    """
    layers: list[tuple[Any, dict[str, Any], str]] = []
    if flat is not None:
        pixels = np.asarray(flat)
        layers.append((pixels, {"name": "flat", "rgb": pixels.ndim == 3}, "image"))
    if rendering is not None:
        image = np.squeeze(rendering.image)
        place = {"scale": rendering.affine[[1, 0], [1, 0]], "translate": rendering.affine[[1, 0], 2]}
        layers.append((image, {"name": "rendering", "rgb": image.ndim == 3, **place}, "image"))
    if depth is not None:
        (shown, *limits), surface = _magnification(depth), depth.surface
        place = {"scale": np.full(2, surface.spacing), "translate": np.array(surface.first[::-1])}
        looks = {"colormap": "turbo", "contrast_limits": tuple(limits), "opacity": 0.5}
        layers.append((shown, {"name": "magnification", **looks, **place}, "image"))
    if calibration is not None:
        look = {"size": 3, "face_color": "cyan", "name": "centres"}
        layers.append((calibration.lattice.centres()[:, ::-1], look, "points"))
    return layers


def _magnification(depth: DepthMap) -> tuple[NDArray[np.float32], float, float]:
    """Magnification on the grid of the surface, clipped to the range of nearly all of it, and that range."""
    whole = depth.pitch / np.maximum(np.abs(depth.surface.patch_size), 1e-3 * depth.pitch)
    low, high = (float(value) for value in np.percentile(whole, (1, 99)))
    high = max(high, 1.2 * low)
    return np.clip(whole, low, high), low, high
