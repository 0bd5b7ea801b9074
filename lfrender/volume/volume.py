"""A reconstructed volume: brightness of voxels, their sizes, and how well it explains the flat."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lfcal.runtime.arrays import Array, Floats, Frozen, Singles
from lfcal.runtime.page import html_card

from ..runtime.types import AnyPath, Entries
from .richardson_lucy import Fit

__all__ = ["Volume", "layer_look"]

# Of the brightness of a projection: brighter voxels are shown white.
_WHITE_QUANTILE = 0.999


@dataclass(frozen=True, eq=False, repr=False)
class Volume(Frozen):
    """The fluorescence under a light-field microscope, plane by plane (experimental).

    Parameters
    ----------
    data : (z, y, x) float32
        Light of each voxel, in the unit of the flat (1 at white): what it adds to a pixel that
        looks through it.
    spacing : (float, float, float)
        Of the voxels along z, y and x. In micrometres, or, where the optics are not known, along z
        in the slope `k = -D / s` and along y and x in pixels of the flat.
    origin : (float, float, float)
        Where voxel (0, 0, 0) lies, in the same unit: z from the native plane, towards the
        objective; y and x from the middle of the first pixel of the flat.
    unit : str
        `"um"` or `"px"`.
    slopes : (z,) float64
        `k = -D / s` of each plane, whatever the unit.
    pitch : float
        Of the microlenses, in the unit of x and y.
    fit : Fit
        Residual of the reprojected flat beside its noise, number of steps and why there were no
        more.
    warnings : tuple of str

    Examples
    --------
    >>> import numpy as np
    >>> from lfrender import Volume
    >>> from lfrender.volume.richardson_lucy import Fit
    >>> fit = Fit(0.05, 0.04, 2, "2 steps were done")
    >>> places = {"spacing": (4.0, 2.5, 2.5), "origin": (-4.0, 0.75, 0.75), "unit": "px"}
    >>> slopes = np.array([-4.0, 0.0, 4.0])
    >>> volume = Volume(np.zeros((3, 32, 40)), slopes=slopes, pitch=20.0, fit=fit, **places)
    >>> volume
    Volume(40 x 32 x 3 voxels of 2.5 px, planes 4 apart in k)
    """

    data: Singles
    spacing: tuple[float, float, float]
    origin: tuple[float, float, float]
    unit: str
    slopes: Floats
    pitch: float
    fit: Fit
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self._set(data=self.data, slopes=self.slopes)

    @property
    def depths(self) -> Floats:
        """(z,) depth of each plane from the native plane [um], or its slope `k = -D / s`."""
        return self.origin[0] + self.spacing[0] * np.arange(len(self.data), dtype=np.float64)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        if copy:
            return np.array(self.data, dtype)
        return np.asarray(self.data, dtype)

    def save(self, path: AnyPath) -> None:
        """Write OME-TIFF (`.ome.tif`, `.tif`) or OME-Zarr (`.zarr`) with the sizes of voxels.

        OutputError or PictureError where that is not possible.
        """
        from .files import write_volume

        write_volume(path, self)

    @classmethod
    def load(cls, path: AnyPath, frame: int = 0) -> Volume:
        """Read what `save` has written, or a `frame` of a time lapse; FlatError of other files."""
        from .files import read_volume

        known = read_volume(path)
        fits = known.pop("fits")
        if not 0 <= frame < len(fits):
            raise ValueError(f"frame must be 0 to {len(fits) - 1}, got {frame}")
        known["fit"] = Fit(**fits[frame])
        del known["interval"]
        if known["data"].ndim == 4:
            known["data"] = known["data"][frame]
        known["slopes"] = np.array(known["slopes"], np.float64)
        for name in ("spacing", "origin", "warnings"):
            known[name] = tuple(known[name])
        return cls(**known)

    def projections(self) -> tuple[Singles, Singles, Singles]:
        """Maximum along z (y, x), along y (z, x) and along x (y, z)."""
        return self.data.max(0), self.data.max(1), np.ascontiguousarray(self.data.max(2).T)

    def plot(self, figure: Any = None) -> Any:
        """Draw the three maximum projections, by default on a new figure, which is returned."""
        import matplotlib.pyplot as plt

        figure = figure or plt.figure(figsize=(5, 5), layout="tight")
        across, along, side = self.projections()
        lengths = np.multiply(self.data.shape, self.spacing)
        low = np.subtract(self.origin, np.divide(self.spacing, 2))
        z, y, x = np.column_stack([low, low + lengths]).tolist()
        unit = "px"
        depth = "k = -D / s"
        # Without optics, depth has another unit: it is shown a third as long as the shorter side.
        shown = lengths[1:].min() / 3
        if self.unit == "um":
            unit = "µm"
            depth = "z [µm]"
            shown = lengths[0]
        ratios = {"width_ratios": [lengths[2], shown], "height_ratios": [lengths[1], shown]}
        axes = figure.subplots(2, 2, gridspec_kw=ratios, squeeze=False)
        white = max(float(np.quantile(across, _WHITE_QUANTILE)), 1e-12)
        looks: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": white, "aspect": "auto"}
        # Rows and columns of the panels, their pixels, and what runs to the right and down.
        panels = [
            (axes[0, 0], across, (x, ""), (y, f"y [{unit}]")),
            (axes[0, 1], side, (z, depth), (y, "")),
            (axes[1, 0], along, (x, f"x [{unit}]"), (z, depth)),
        ]
        for panel, pixels, (right, below), (down, beside) in panels:
            panel.imshow(pixels, extent=(*right, *down[::-1]), **looks)
            panel.set(xlabel=below, ylabel=beside)
        axes[1, 1].axis("off")
        return figure

    def napari_layer(self, name: str = "volume") -> tuple[Any, dict[str, Any], str]:
        """The volume as a layer of napari (data, keywords, type); napari is not needed.

        Add it by `viewer.add_layer(napari.layers.Layer.create(*volume.napari_layer()))`.
        """
        return self.data, layer_look(name, self.spacing, self.origin), "image"

    def __repr__(self) -> str:
        deep, high, wide = self.data.shape
        dz, dy, dx = self.spacing
        size = f"{dx:.3g} px, planes {dz:.3g} apart in k"
        if self.unit == "um":
            size = f"{dx:.3g} x {dy:.3g} x {dz:.3g} um"
        return f"Volume({wide} x {high} x {deep} voxels of {size})"

    def _repr_html_(self) -> str:
        unit = "(k = -D / s)"
        if self.unit == "um":
            unit = "µm"
        figures = {
            "depth": f"{self.depths[0]:.4g} to {self.depths[-1]:.4g} {unit}",
            "residual": f"{self.fit.residual:.1%} of the flat, noise {self.fit.noise:.1%}",
            "steps": f"{self.fit.steps}: {self.fit.reason}",
        }

        def draw(axes: Any) -> None:
            figure = axes.figure
            axes.remove()
            self.plot(figure)

        return html_card(repr(self), figures, draw, self.warnings)


def layer_look(name: str, spacing: Sequence[float], origin: Sequence[float]) -> Entries:
    """How napari shows voxels, by the arguments of its layers."""
    look = {"name": name, "colormap": "gray", "rendering": "mip", "blending": "additive"}
    return {**look, "scale": spacing, "translate": origin}
