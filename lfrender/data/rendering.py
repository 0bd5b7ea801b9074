"""A rendered picture, and where its pixels lie on the microlens plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal.runtime.frozen import Frozen

if TYPE_CHECKING:
    from lfcal import Calibration

__all__ = ["Rendering", "check_patch_size", "check_scale", "convert_to_dtype", "finish_picture"]


def check_scale(scale: float, pitch: float) -> float:
    """The scale [px per pitch] as a float, or a ValueError that says which are possible."""
    if not (np.isfinite(scale) and 0 < scale <= 4 * pitch):
        raise ValueError(f"scale must lie between 0 and four times the pitch ({4 * pitch:.0f}), got {scale:g}")
    return float(scale)


def check_patch_size(patch_size: float, pitch: float) -> None:
    """Raise a ValueError unless `|patch_size|` [px] lies between 0 and the pitch."""
    if not 0 < abs(patch_size) < pitch:
        raise ValueError(f"patch_size must lie between 0 and the pitch {pitch:.1f} px, got {patch_size:g}")


@dataclass(frozen=True, eq=False, repr=False)
class Rendering(Frozen):
    """A picture drawn from a flat.

    Parameters
    ----------
    image : (h, w) or (h, w, C) array
        Of the flat's dtype and number of channels; 0 where nothing was seen.
    affine : (2, 3) float64
        From output pixel `(u, v, 1)` to scene coordinates `X` of docs/geometry.md [flat px].
    valid : (h, w) bool
        Pixels that at least one lens has seen.
    scale : float
        Output pixels per microlens pitch, `P`.
    white : float, optional
        White level of an integer image, if it is less than the largest value of the type.
    noise : float, optional [white]
        Standard deviation of the noise of a pixel of the flat in the light of white, if the detail was restored.

    Examples
    --------
    >>> import lfrender
    >>> sample = lfrender.data.house(size=(240, 180), samples=2)
    >>> flat, camera = sample.flat, sample.truth.calibration
    >>> depth = lfrender.analyze(flat, camera, "fast")
    >>> picture = lfrender.render(flat, camera, depth, scale=6)
    >>> picture.image.shape, picture.scale
    ((47, 62, 3), 6.0)
    >>> (picture.affine @ [0, 0, 1]).round().tolist()  # where the first pixel lies on the flat
    [1.0, 1.0]
    """

    image: NDArray
    affine: NDArray[np.float64]
    valid: NDArray[np.bool_]
    scale: float
    white: float | None = None
    noise: float | None = None

    def plot(self, ax: Any = None) -> Any:
        """Draw the picture over scene coordinates.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            By default the current one.

        Returns
        -------
        matplotlib.axes.Axes
        """
        from .plots import plot_rendering

        return plot_rendering(self, ax)

    def __repr__(self) -> str:
        height, width = self.image.shape[:2]
        channels = self.image.shape[2] if self.image.ndim == 3 else 1
        return (
            f"Rendering({width} x {height} px, {channels} x {self.image.dtype}, {self.scale:.4g} px per pitch, "
            f"{np.mean(self.valid):.1%} seen)"
        )

    def _repr_html_(self) -> str:
        from .plots import rendering_html

        return rendering_html(self)


def finish_picture(
    image: NDArray,
    valid: NDArray[np.bool_],
    affine: NDArray[np.float64],
    scale: float,
    flat: NDArray,
    calibration: Calibration,
) -> Rendering:
    """A picture (h, w, C) as a `Rendering` with the dtype and the number of dimensions of the flat."""
    if np.ndim(flat) == 2 and image.shape[2] == 1:
        image = image[:, :, 0]
    return Rendering(convert_to_dtype(image, np.asarray(flat).dtype), affine, valid, scale, calibration.white_level)


def convert_to_dtype(image: NDArray, dtype: np.dtype) -> NDArray:
    """Round and clip to the range of `dtype`, in place."""
    if dtype.kind == "f" or image.dtype == dtype:
        return image.astype(dtype, copy=False)
    # As the kernels round: add a half and truncate.
    image += image.dtype.type(0.5)
    return np.clip(image, 0, np.iinfo(dtype).max, out=image).astype(dtype)
