"""A reconstructed volume: brightness of voxels, their sizes, and how well it explains the flat."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np

from lfcal.runtime.arrays import Array, Floats, Frozen, Singles
from lfcal.runtime.page import html_card

from .richardson_lucy import Fit

__all__ = ["Volume"]

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
    >>> import numpy as np, lfrender
    >>> from lfcal import Calibration, Lattice
    >>> camera = Calibration(Lattice([10, 10], [[20, 0], [0, 20]], (100, 80), 9))
    >>> flat = np.full((80, 100), 0.5, np.float32)
    >>> volume = lfrender.reconstruct_volume(flat, camera, depth_range=(-4, 4), planes=3, steps=2)
    >>> volume.data.shape, volume.spacing, volume.unit
    ((3, 32, 40), (4.0, 2.5, 2.5), 'px')
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
        """(z,) depth of each plane from the native plane: in micrometres, or as the slope `k = -D /
        s`."""
        return self.origin[0] + self.spacing[0] * np.arange(len(self.data), dtype=np.float64)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.data, dtype) if copy else np.asarray(self.data, dtype)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write OME-TIFF (`.ome.tif`, `.tif`) or OME-Zarr (`.zarr`) with the sizes of voxels; whole
        or not at all.

        OutputError or PictureError where that is not possible.
        """
        from .files import write_volume

        write_volume(path, self)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Volume:
        """Read what `save` has written; FlatError where it is something else."""
        from .files import read_volume

        known = read_volume(path)
        known["fit"] = Fit(**known["fit"])
        known["slopes"] = np.array(known["slopes"], np.float64)
        for name in ("spacing", "origin", "warnings"):
            known[name] = tuple(known[name])
        return cls(**known)

    def projections(self) -> tuple[Singles, Singles, Singles]:
        """Maximum along z (y, x), along y (z, x) and along x (y, z)."""
        return self.data.max(0), self.data.max(1), np.ascontiguousarray(self.data.max(2).T)

    def plot(self, figure: Any = None) -> Any:
        """Draw the three maximum projections, by default on a new Matplotlib figure, which is
        returned."""
        import matplotlib.pyplot as plt

        figure = figure or plt.figure(figsize=(5, 5), layout="tight")
        across, along, side = self.projections()
        deep, high, wide = self.data.shape
        dz, dy, dx = self.spacing
        lengths = deep * dz, high * dy, wide * dx
        # Without optics, depth has another unit: it is shown a third as long as the shorter side.
        shown = lengths[0] if self.unit == "um" else min(lengths[1:]) / 3
        ratios = {"width_ratios": [lengths[2], shown], "height_ratios": [lengths[1], shown]}
        axes = figure.subplots(2, 2, gridspec_kw=ratios, squeeze=False)
        name = "z [µm]" if self.unit == "um" else "k = -D / s"
        z0, y0, x0 = self.origin
        z_ends = z0 - dz / 2, z0 + (deep - 0.5) * dz
        y_ends = y0 + (high - 0.5) * dy, y0 - dy / 2
        x_ends = x0 - dx / 2, x0 + (wide - 0.5) * dx
        white = max(float(np.quantile(across, _WHITE_QUANTILE)), 1e-12)
        looks: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": white, "aspect": "auto"}
        unit = "µm" if self.unit == "um" else "px"
        axes[0, 0].imshow(across, extent=(*x_ends, *y_ends), **looks)
        axes[0, 0].set(ylabel=f"y [{unit}]")
        axes[0, 1].imshow(side, extent=(*z_ends, *y_ends), **looks)
        axes[0, 1].set(xlabel=name)
        axes[1, 0].imshow(along, extent=(*x_ends, z_ends[1], z_ends[0]), **looks)
        axes[1, 0].set(xlabel=f"x [{unit}]", ylabel=name)
        axes[1, 1].axis("off")
        return figure

    def napari_layer(self, name: str = "volume") -> tuple[Any, dict[str, Any], str]:
        """The volume as a layer of napari, (data, keywords, type), in its own unit; napari need not
        be installed.

        Add it by `viewer.add_layer(napari.layers.Layer.create(*volume.napari_layer()))`.
        """
        look = {"name": name, "colormap": "gray", "rendering": "mip", "blending": "additive"}
        return self.data, {**look, "scale": self.spacing, "translate": self.origin}, "image"

    def __repr__(self) -> str:
        deep, high, wide = self.data.shape
        dz, dy, dx = self.spacing
        size = f"{dx:.3g} px, planes {dz:.3g} apart in k"
        if self.unit == "um":
            size = f"{dx:.3g} x {dy:.3g} x {dz:.3g} um"
        return f"Volume({wide} x {high} x {deep} voxels of {size})"

    def _repr_html_(self) -> str:
        unit = "µm" if self.unit == "um" else "(k = -D / s)"
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
