"""Depth maps and pictures in a notebook, on Matplotlib axes, and in napari."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal import Calibration
from lfcal.runtime.notebook import html_card

if TYPE_CHECKING:
    from .depth_map import DepthMap
    from .rendering import Rendering

__all__ = ["depth_html", "napari_layers", "plot_depth", "plot_rendering", "rendering_html"]

# Colour of unresolved lenses, as in the maps of `lfrender.output.depth_picture`.
_UNRESOLVED = (150, 150, 150)


def depth_html(depth: DepthMap) -> str:
    """HTML with the magnification over the scene in colours, unresolved lenses grey, and the figures of a depth map."""
    modes = ((1, "telescopic"), (-1, "binocular"), (0, "unresolved"))
    figures = {
        "lenses": f"{len(depth)}, preset {depth.preset}",
        "modes": ", ".join(f"{name} {float(np.mean(depth.mode == code)):.1%}" for code, name in modes),
    }
    known = depth.magnification[np.isfinite(depth.magnification)]
    if known.size:
        figures["magnification"] = f"{known.min():.2f} to {known.max():.2f}, median {np.median(known):.2f}"
        figures["standard error of s"] = f"{np.median(depth.standard_error[depth.mode != 0]):.2g} px (median)"
    if depth.saved:
        figures["saved"] = ", ".join(f"{name} {part:.0%}" for name, part in depth.saved.items())
    return html_card("DepthMap", figures, depth.plot)


def rendering_html(rendering: Rendering) -> str:
    """HTML with a picture and its key figures."""
    height, width = rendering.image.shape[:2]
    figures = {
        "picture": f"{width} x {height} px, {rendering.image.dtype}",
        "scale": f"{rendering.scale:.2f} px per pitch",
        "seen by lenses": f"{float(np.mean(rendering.valid)):.1%}",
    }
    return html_card("Rendering", figures, rendering.plot)


def plot_depth(depth: DepthMap, ax: Any = None) -> Any:
    """`DepthMap.plot`."""
    import matplotlib.pyplot as plt
    from matplotlib.colors import LogNorm

    ax = ax or plt.gca()
    (shown, low, high), surface = _magnification(depth), depth.surface
    lens = depth.nearest_lens(shown.shape, surface.first, surface.spacing)
    if lens is not None:
        shown[depth.filled[lens]] = np.nan
    left, top = (first - surface.spacing / 2 for first in surface.first)
    extent = (left, left + shown.shape[1] * surface.spacing, top + shown.shape[0] * surface.spacing, top)
    drawn = ax.imshow(shown, extent=extent, norm=LogNorm(low, high), cmap="turbo", interpolation="nearest")
    ax.set_facecolor(np.array(_UNRESOLVED) / 255)
    bar = ax.figure.colorbar(drawn, ax=ax, label="magnification M (grey: unresolved)")
    bar.set_ticks(np.geomspace(low, high, 5), labels=[f"{tick:.2g}" for tick in np.geomspace(low, high, 5)])
    bar.minorticks_off()
    ax.set(xlabel="x [flat px]", ylabel="y [flat px]", title="Magnification")
    return ax


def plot_rendering(rendering: Rendering, ax: Any = None) -> Any:
    """`Rendering.plot`."""
    import matplotlib.pyplot as plt

    ax = ax or plt.gca()
    image = rendering.image
    if image.dtype.kind == "u":
        image = image / np.float32(rendering.white or np.iinfo(image.dtype).max)
    height, width = image.shape[:2]
    corners = rendering.affine @ [[-0.5, width - 0.5], [-0.5, height - 0.5], [1.0, 1.0]]
    extent = (corners[0, 0], corners[0, 1], corners[1, 1], corners[1, 0])
    ax.imshow(np.clip(np.squeeze(image), 0, 1), extent=extent, cmap="gray", vmin=0, vmax=1)
    ax.set(xlabel="x [flat px]", ylabel="y [flat px]", title=f"{rendering.scale:.1f} px per pitch")
    return ax


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
        shown, low, high = _magnification(depth)
        surface = depth.surface
        place = {"scale": np.full(2, surface.spacing), "translate": np.array(surface.first[::-1])}
        looks = {"colormap": "turbo", "contrast_limits": (low, high), "opacity": 0.5}
        layers.append((shown, {"name": "magnification", **looks, **place}, "image"))
    if calibration is not None:
        look = {"size": 3, "face_color": "cyan", "name": "centres"}
        layers.append((calibration.lattice.centres()[:, ::-1], look, "points"))
    return layers


def _magnification(depth: DepthMap) -> tuple[NDArray[np.float32], float, float]:
    """Magnification on the grid of the surface, clipped to the range of nearly all of it, and that range."""
    size = np.abs(depth.surface.patch_size)
    whole = depth.pitch / np.maximum(size, 1e-3 * depth.pitch)
    low, high = (float(value) for value in np.percentile(whole, (1, 99)))
    high = max(high, 1.2 * low)
    return np.clip(whole, low, high), low, high
