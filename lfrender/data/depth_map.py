"""Result of the depth analysis: patch size, mode and confidence of every lens, and its files."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal import Calibration, CalibrationError, FlatSource, LensBlur, Optics
from lfcal.runtime.arrays import MOST, Array, Booleans, Floats, Frozen, Integers, Singles
from lfcal.runtime.errors import CAMERA_ADVICE, check_type
from lfcal.runtime.page import html_card

from ..flat.lens_graph import nearest_lens
from ..runtime.types import AnyPath, Entries, Place, Size
from .depth_file import DepthFileError, check_columns, check_extent, read_depth, write_depth
from .depth_order import depth_limits, depth_order, magnification_at
from .flat_samples import is_same_flat, sample_flat
from .frame_state import FrameState
from .rendering import show_on_axes
from .surface import Surface

if TYPE_CHECKING:
    from .dense_depth import DenseDepth

__all__ = [
    "BINOCULAR",
    "DEPTH_ADVICE",
    "MODES",
    "MODE_COLOURS",
    "RARE_MODE",
    "REASONS",
    "TELESCOPIC",
    "UNRESOLVED",
    "DepthFileError",
    "DepthMap",
    "check_depth",
    "default_scale",
    "finite",
    "magnification_range",
]


#: Codes of `DepthMap.mode`.
TELESCOPIC = 1
BINOCULAR = -1
UNRESOLVED = 0
MODES = {TELESCOPIC: "telescopic", BINOCULAR: "binocular", UNRESOLVED: "unresolved"}
#: Why a lens is unresolved, by the code in `DepthMap.reason`; 0 is resolved.
REASONS = (
    "resolved",
    "too little texture",
    "ambiguous",
    "image plane on the microlenses",
    "not analysed",
)
#: Where a depth map comes from, for `check_type`.
DEPTH_ADVICE = "lfrender.analyze makes one of a flat, DepthMap.load reads one from a file"
# Patch sizes of more lenses than this share keep the resolution of the flat.
_FULL_RESOLUTION = 0.98
#: Share of the lenses below which a mode is taken for errors.
RARE_MODE = 0.01
#: Colours of the modes, which colour-blind eyes can tell apart too.
MODE_COLOURS = {1: (230, 126, 34), -1: (41, 112, 201), 0: (150, 150, 150)}
# Largest patch size [pitches]: beyond some pitches no two lenses show the same place.
_MOST_PITCHES = 100
# Values of a surface in a row or column of a plot: more than a figure has pixels.
_PLOTTED = 1000
# Least patch size whose magnification is shown [pitches].
_LEAST_PATCH = 1e-3
# Least ratio between the ends of a scale of magnifications.
_NARROWEST_SCALE = 1.2
# Part of the pitch up to which pitches and centres are those of one camera, as calibrated from
# several flats: a right lattice is known to a twentieth of the pitch.
_SAME_CENTRE = 0.05
# Distances of output pixels from one to its double: steps of 19 %, while noise moves the depth of a
# static scene by 1 %.
_SPACINGS_PER_OCTAVE = 4


@dataclass(frozen=True, eq=False, repr=False)
class DepthMap(Frozen):
    """Depth of every lens, in the order of `lattice.centres()`, and of every place of the picture.

    Parameters
    ----------
    patch_size : (n,) float32 [px]
        Signed patch size `s` of docs/geometry.md: positive telescopic, negative binocular, NaN
        where unresolved.
    standard_error : (n,) float32 [px]
        Of `patch_size`, from the scatter over the pairs with each neighbour; inf where unknown. If
        the whole scene is one plane, all lenses share the error of that plane.
    confidence : (n,) float32
        0..1, the probability that `patch_size` is the right optimum of the match.
    filled_patch_size : (n,) float32 [px]
        `patch_size`, with unresolved lenses filled by the matching, which follows their neighbours;
        finite.
    surface : Surface
        `filled_patch_size` densified to a regular grid of scene points, with depth edges located on
        the pixels.
    pitch : float [px]
    image_size : (int, int) [px]
        Width and height of the flat.
    preset : str
        Preset it was analysed with.
    reason : (n,) int8, optional
        0 resolved, 1 too little texture, 2 ambiguous or periodic, 3 image plane on the microlenses,
        4 not analysed. By default unresolved lenses are 1 where their confidence is 0, else 2.
    saved : dict of str to float
        Share of the work that each shortcut left out: of the lenses, for `ranges` of the shifts.
        Empty if none was taken.
    frame_state : FrameState
        For the analysis of the next frame; of it is saved what earlier frames leave.
    flat_samples : (m,) float32 or None
        Fingerprint of the flat that it was made from; None where that is unknown.
    centres : (n, 2) float32 [px] or None
        Of the microimages, for plots; None in files of earlier versions.
    lens_blur : LensBlur or None
        Discs of the microlenses as the capture shows them (`lfcal.measure_lens_blur`), None where
        the camera file tells them or too few lenses show the same place.
    camera : str or None
        Digest of `image_size`, `pitch` and `centres` as they were analysed, which `load` compares
        with them; None where that is unknown.

    Examples
    --------
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> len(depth) == len(camera.lattice), set(depth.mode.tolist()) <= {-1, 0, 1}
    (True, True)
    >>> bool((depth.magnification[depth.mode != 0] >= 1).all())
    True
    """

    patch_size: Singles
    standard_error: Singles
    confidence: Singles
    filled_patch_size: Singles
    surface: Surface
    pitch: float
    image_size: Size
    preset: str = "balanced"
    reason: NDArray[np.int8] = None  # type: ignore[assignment]
    saved: dict[str, float] = field(default_factory=dict)
    frame_state: FrameState = field(default_factory=FrameState, repr=False, compare=False)
    flat_samples: Singles | None = field(default=None, repr=False, compare=False)
    centres: Singles | None = field(default=None, repr=False, compare=False)
    lens_blur: LensBlur | None = field(default=None, repr=False, compare=False)
    camera: str | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_type(self.surface, Surface, "surface", "lfrender.data.surface.Surface makes one")
        names = ("patch_size", "standard_error", "confidence", "filled_patch_size")
        self._set(**{name: np.array(getattr(self, name), dtype=np.float32) for name in names})
        resolved = np.isfinite(self.patch_size)
        reason = self.reason
        if reason is None:
            reason = np.where(resolved, 0, np.where(self.confidence > 0, 2, 1))
        width, height = self.image_size
        self._set(reason=np.array(reason, np.int8), image_size=(int(width), int(height)))
        arrays = {name: getattr(self, name) for name in (*names, "reason", "centres")}
        known = {name: values for name, values in arrays.items() if values is not None}
        check_columns(known | {"pitch": np.asarray(self.pitch)})
        if ((self.reason == 0) != resolved).any():
            raise ValueError(
                "reason must be 0 for every lens with a patch size, and only for those"
            )
        for values in (self.filled_patch_size, self.surface.patch_size):
            if not np.abs(values).max(initial=0) <= _MOST_PITCHES * self.pitch:
                raise ValueError(
                    f"filled_patch_size and surface must be finite, at most {_MOST_PITCHES} pitches"
                )

    def __len__(self) -> int:
        return len(self.patch_size)

    @cached_property
    def mode(self) -> NDArray[np.int8]:
        """(n,) int8: 1 telescopic, -1 binocular, 0 unresolved."""
        return np.sign(np.nan_to_num(self.patch_size)).astype(np.int8)

    @cached_property
    def magnification(self) -> Singles:
        """(n,) float32: `M = D / |s|` (Lumsdaine and Georgiev 2008); NaN where unresolved."""
        with np.errstate(divide="ignore"):
            return (self.pitch / np.abs(self.patch_size)).astype(np.float32)

    @cached_property
    def curvature(self) -> Singles:
        """(n,) float32 [1/px^2]: curvature of the log likelihood; 0 where unknown."""
        with np.errstate(divide="ignore"):
            return (1 / self.standard_error.astype(np.float64) ** 2).astype(np.float32)

    @cached_property
    def filled(self) -> Booleans:
        """(n,) bool: unresolved lenses, whose `filled_patch_size` comes from their neighbours."""
        return np.isnan(self.patch_size)

    def nearest_lens(self, shape: Size, first: ArrayLike, spacing: float) -> Integers | None:
        """(h, w) number of the lens nearest to each pixel; None if the centres are unknown.

        Pixels lie `spacing` [px] apart; `first` is the place of the first.
        """
        if self.centres is None:
            return None
        v, u = np.indices(shape, np.float32)
        places = np.asarray(first) + spacing * np.stack([u, v], -1).reshape(-1, 2)
        return nearest_lens(self.centres, places).reshape(shape)

    def is_of(self, flat: Array | FlatSource) -> bool:
        """Whether it was made from this flat (H, W) or (H, W, C); True if that is unknown.

        Flats of a colour filter mosaic are given in colour, as they were analysed.
        """
        return self.flat_samples is None or is_same_flat(self.flat_samples, sample_flat(flat))

    def distance(self, camera: Optics | Calibration) -> Floats:
        """(n,) float64 [m]: distance of what each lens shows, in front of the main lens.

        NaN where unresolved.

        A Calibration with `optics`, as made by `calibrate_metric`, also takes account of the tilt
        of its array and of the curvature of its field, which Optics alone cannot. CalibrationError
        if it has no optics.
        """
        optics, points = self._optics(camera)
        return optics.distance(self.patch_size.astype(np.float64) / self.pitch, points)

    def distance_error(self, camera: Optics | Calibration) -> Floats:
        """(n,) float64 [m]: standard errors of `distance`, from `patch_size` and calibration.

        Errors of the calibration are shared by all lenses: they do not average out. inf where
        unknown, NaN where unresolved.
        """
        optics, points = self._optics(camera)
        error = self.standard_error.astype(np.float64) / self.pitch
        return optics.distance_error(self.patch_size.astype(np.float64) / self.pitch, error, points)

    def _optics(self, camera: Optics | Calibration) -> tuple[Optics, Floats | None]:
        """The optics, and the centres of the lenses if they are known."""
        if isinstance(camera, Optics):
            return camera, None
        check_type(camera, Calibration, "camera", f"{CAMERA_ADVICE}, or give lfcal.Optics")
        if camera.optics is None:
            raise CalibrationError(
                "the camera file holds no optics; measure them with 'lfcal metric FLAT...'"
            )
        check_depth(self, camera)
        return camera.optics, camera.lattice.centres()

    def dense(self, scale: float | None = None, fill: bool = True) -> DenseDepth:
        """Patch size, validity and error of every pixel, by `lfrender.data.dense_depth`."""
        from .. import dense_depth

        made: DenseDepth = dense_depth(self, scale, fill)
        return made

    def to_table(self) -> Any:
        """One row for each lens, as a `pandas.DataFrame`, or a NumPy record array without pandas.

        Columns are `x` and `y` of its centre [px] (NaN if the centres are unknown), `patch_size`
        and its `standard_error` [px], `magnification`, `mode` and `reason` in words, `confidence`.

        Examples
        --------
        >>> import lfrender
        >>> table = lfrender.data.example()[2].to_table()
        >>> len(table), str(table["mode"][0])
        (95, 'telescopic')
        """
        centres = self.centres
        if centres is None:
            centres = np.full((len(self), 2), np.nan, np.float32)
        columns = {
            "x": centres[:, 0],
            "y": centres[:, 1],
            "patch_size": self.patch_size,
            "standard_error": self.standard_error,
            "magnification": self.magnification,
            "mode": np.array([MODES[code] for code in self.mode.tolist()]),
            "reason": np.array(REASONS)[self.reason],
            "confidence": self.confidence,
        }
        try:
            from pandas import DataFrame
        except ImportError:
            types = [(name, column.dtype) for name, column in columns.items()]
            return np.rec.fromarrays(list(columns.values()), dtype=types)
        return DataFrame(columns)

    def plot(self, ax: Any = None) -> Any:
        """Draw depth from far to near over the scene, by default on the current axes; returns them."""
        surface = self.surface.thinned(_PLOTTED)
        shown = depth_order(surface.patch_size, self.pitch)
        far, near = depth_limits(self)
        lens = self.nearest_lens(shown.shape, surface.first, surface.spacing)
        if lens is not None:
            shown[self.filled[lens]] = np.nan
        half = surface.spacing / 2
        first = np.array(surface.first) - half
        last = surface.last + half
        look: Entries = {"vmin": far, "vmax": near, "cmap": "viridis"}
        drawn = show_on_axes(ax, shown, first, last, "Depth", interpolation="nearest", **look)
        drawn.axes.set_facecolor(np.array(MODE_COLOURS[0]) / 255)
        label = "M, from far to near (grey: unresolved)"
        bar = drawn.figure.colorbar(drawn, ax=drawn.axes, label=label)
        ticks = np.linspace(far, near, 5).tolist()
        bar.set_ticks(ticks, labels=[f"{magnification_at(tick):.2g}" for tick in ticks])
        bar.minorticks_off()
        return drawn.axes

    def clipped_magnification(self) -> tuple[Singles, float, float]:
        """(h, w) magnification on the grid of the surface, clipped to a range, and this range.

        98 % of the values lie in the range.
        """
        least = _LEAST_PATCH * self.pitch
        whole = self.pitch / np.maximum(np.abs(self.surface.patch_size), least)
        low, high = magnification_range(whole)
        return np.clip(whole, low, high), low, high

    def __repr__(self) -> str:
        parts = [f"{len(self)} lenses"]
        for code, name in MODES.items() if len(self) else ():
            parts.append(f"{np.mean(self.mode == code):.0%} {name}")
        return f"DepthMap({', '.join(parts)}; {self.preset!r})"

    def _repr_html_(self) -> str:
        figures = {}
        known = finite(self.magnification)
        if known.size:
            ends = f"{known.min():.2f} to {known.max():.2f}"
            figures["magnification"] = f"{ends}, median {np.median(known):.2f}"
            error = np.median(self.standard_error[self.mode != 0])
            figures["standard error of s"] = f"{error:.2g} px (median)"
        if self.saved:
            figures["saved"] = ", ".join(f"{name} {part:.0%}" for name, part in self.saved.items())
        return html_card(repr(self), figures, self.plot)

    def save(self, path: AnyPath) -> None:
        """Write as `.npz`; the file appears whole or not at all."""
        write_depth(self, path)

    @classmethod
    def load(cls, path: AnyPath) -> DepthMap:
        """Read a file written by `save`; DepthFileError if it is missing or damaged.

        Files of other programs need no digests, but values within their ranges.
        """
        return read_depth(path, cls)


def finite(values: Array) -> Array:
    """The values that are known and not at infinity."""
    return values[np.isfinite(values)]


def magnification_range(magnification: Array) -> Place:
    """Ends of a scale that holds 98 % of these magnifications, at least a fifth wide."""
    low, high = np.percentile(magnification, MOST)
    return float(low), float(max(high, _NARROWEST_SCALE * low))


def check_depth(depth: DepthMap, calibration: Calibration) -> None:
    """Raise a CalibrationError if depth map and camera do not belong to each other."""
    check_type(calibration, Calibration, "calibration", CAMERA_ADVICE)
    check_type(depth, DepthMap, "depth", DEPTH_ADVICE)
    lattice = calibration.lattice
    same = depth.image_size == lattice.image_size and len(depth) == len(lattice)
    same = same and abs(depth.pitch / lattice.pitch - 1) <= _SAME_CENTRE
    if same and depth.centres is not None:
        apart = np.abs(depth.centres - lattice.centres()).max(initial=0)
        same = apart <= _SAME_CENTRE * lattice.pitch
    if not same:
        raise CalibrationError(
            "the depth map was made with another camera or flat size; analyze this flat"
        )
    check_extent(depth)


def default_scale(depth: DepthMap) -> float:
    """Output pixels per pitch that keep the resolution of the flat in the largest patches.

    Full resolution after Lumsdaine and Georgiev 2008, section 4: as many output pixels per lens as
    its patch has, for 98 % of the lenses. The distance of output pixels is rounded to 1, 1.19,
    1.41, 1.68, 2, 2.38 ... px of the flat, so that pictures of one camera have one size, whatever
    they show at about one depth.

    Examples
    --------
    >>> import lfrender
    >>> bool(1 < default_scale(lfrender.data.example()[2]) < 23.2)
    True
    """
    check_type(depth, DepthMap, "depth", DEPTH_ADVICE)
    sizes = np.abs(finite(depth.patch_size))
    if not sizes.size:
        return 1.0
    spacing = depth.pitch / float(np.quantile(sizes.astype(float), _FULL_RESOLUTION))
    rounded = 2.0 ** (round(_SPACINGS_PER_OCTAVE * np.log2(spacing)) / _SPACINGS_PER_OCTAVE)
    return max(1.0, depth.pitch / rounded)
