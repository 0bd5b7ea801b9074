"""A rendered picture, and where its pixels lie on the microlens plane."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from lfcal import LightFieldError
from lfcal.runtime.arrays import Array, Booleans, Floats, Frozen
from lfcal.runtime.errors import check_type
from lfcal.runtime.light.tone import exposure_gain, is_encoded, to_eight_bits
from lfcal.runtime.packages import import_package
from lfcal.runtime.page import html_card

from ..runtime.types import AnyPath, Entries, Region, Size, Triple

if TYPE_CHECKING:
    from lfcal import Calibration

__all__ = [
    "PICTURE_ADVICE",
    "Part",
    "Picture",
    "PictureGrid",
    "Rendering",
    "check_patch_size",
    "check_pictures",
    "check_scale",
    "convert_to_dtype",
    "finish_picture",
    "pixels_between",
    "scene_points",
    "show_on_axes",
]

#: Where a picture comes from, for `check_type`.
PICTURE_ADVICE = "lfrender.render makes one"
#: Columns and rows `left, top, right, bottom` of a picture or a flat [px], the last two not
#: included.
Part = tuple[int, int, int, int]


@dataclass(frozen=True)
class PictureGrid:
    """The pixels of a picture of all that a flat shows."""

    image_size: Size  # width and height of the flat [px]
    pitch: float  # [px]
    scale: float  # pixels of the picture per pitch

    @property
    def spacing(self) -> float:
        """Distance between pixels [px of the flat]."""
        return self.pitch / self.scale

    @property
    def first(self) -> float:
        """Scene coordinates x and y of pixel (0, 0) [px of the flat]."""
        return 0.5 * self.spacing - 0.5

    @property
    def size(self) -> Size:
        """Columns and rows."""
        # The last digits of the pitch do not decide what is done with halves.
        columns, rows = (
            math.floor(length / self.spacing + 0.5 - 1e-6) for length in self.image_size
        )
        return max(1, columns), max(1, rows)

    @property
    def whole(self) -> Part:
        """All of the picture."""
        return 0, 0, *self.size

    def affine(self, part: Part | None = None) -> Floats:
        """(2, 3) from a pixel of a part, by default of the whole, to scene coordinates."""
        left, top = (part or self.whole)[:2]
        step = self.spacing
        first = self.first
        return np.array([[step, 0.0, first + step * left], [0.0, step, first + step * top]])

    def flat_part(self, part: Part, halo: int) -> Part:
        """The part of the flat within `halo` [px] of the scene points of a part of the picture."""
        low = [max(int(self.first + self.spacing * k) - halo, 0) for k in part[:2]]
        high = [int(np.ceil(self.first + self.spacing * (k - 1))) + halo + 1 for k in part[2:]]
        return low[0], low[1], min(self.image_size[0], high[0]), min(self.image_size[1], high[1])

    def expand(self, part: Part, halo: int) -> Part:
        """A part of the picture with up to `halo` pixels around it, as far as there are any."""
        left, top, right, bottom = part
        return _intersect(self.whole, (left - halo, top - halo, right + halo, bottom + halo))

    def part_of_region(self, roi: Region) -> Part:
        """Columns and rows whose scene points lie in `x0, y0, x1, y1`, at least one of each."""
        corners = (np.array(roi).reshape(2, 2) - self.first) / self.spacing
        return pixels_between(corners, self.size)

    def tiles(self, side: Size) -> Iterator[Part]:
        """Parts of at most `side` (columns, rows), row by row."""
        columns, rows = self.size
        for top in range(0, rows, side[1]):
            for left in range(0, columns, side[0]):
                yield left, top, min(left + side[0], columns), min(top + side[1], rows)


def _intersect(one: Part, other: Part) -> Part:
    left, top = map(max, one[:2], other[:2])
    right, bottom = map(min, one[2:], other[2:])
    return left, top, right, bottom


def pixels_between(corners: Floats, size: Size) -> Part:
    """The pixels, at least one, between two corners (2, 2) of a picture of this width and height.

    Corners are in pixels; pixel centres lie at integers.
    """
    low, high = corners
    last = np.array(size)
    first = np.clip(np.ceil(low), 0, last - 1)
    end = np.clip(np.floor(high) + 1, first + 1, last)
    left, top, right, bottom = np.concatenate([first, end]).astype(int).tolist()
    return left, top, right, bottom


def check_pictures(pictures: Any) -> Iterator[Rendering]:
    """The pictures one by one; TypeError if one of them is something else."""
    check_type(
        pictures, Iterable, "pictures", "give a list of what lfrender.render or lfrender.views draw"
    )
    for picture in pictures:
        check_type(picture, Rendering, "pictures", PICTURE_ADVICE)
        yield picture


def check_scale(scale: float, pitch: float) -> float:
    """The scale [px per pitch] as a float, or a ValueError that says which are possible."""
    if not (np.isfinite(scale) and 0 < scale <= 4 * pitch):
        raise ValueError(
            f"scale must lie between 0 and four times the pitch ({4 * pitch:.0f}), got {scale:g}"
        )
    return float(scale)


def check_patch_size(patch_size: float, pitch: float) -> None:
    """Raise a ValueError unless `|patch_size|` [px] lies between 0 and the pitch."""
    if not 0 < abs(patch_size) < pitch:
        signs = f"-{pitch:.1f} and 0 px (binocular) or 0 and {pitch:.1f} px (telescopic)"
        raise ValueError(f"patch_size must lie between {signs}, got {patch_size:g}")


class Picture:
    """Base of records on the grid of a picture: as an array, they are their pixels."""

    affine: Floats
    # Names of the fields with the pixels and, after them, with arrays (h, w) about each pixel.
    _layers: ClassVar[tuple[str, ...]]

    @property
    def _pixels(self) -> Array:
        found: Array = getattr(self, self._layers[0])
        return found

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows, columns and, if there are several, channels of the pixels."""
        return self._pixels.shape

    def __getitem__(self, key: Any) -> Any:
        """Pixels, as of an array."""
        return self._pixels[key]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        if copy:
            return np.array(self._pixels, dtype)
        return np.asarray(self._pixels, dtype)

    def to_xarray(self) -> Any:
        """An `xarray.DataArray` with scene coordinates `x, y` [px of the flat].

        The other arrays become coordinates too.

        LightFieldError if the package `xarray` is not installed.
        """
        xarray = import_package("xarray", "arrays with coordinates need", LightFieldError)
        name, *others = self._layers
        pixels = self._pixels
        height, width = pixels.shape[:2]
        places = {
            "y": self.affine[1, 2] + self.affine[1, 1] * np.arange(height),
            "x": self.affine[0, 2] + self.affine[0, 0] * np.arange(width),
        }
        about = {key: (("y", "x"), getattr(self, key)) for key in others}
        return xarray.DataArray(
            pixels, {**places, **about}, ("y", "x", "channel")[: pixels.ndim], name
        )


@dataclass(frozen=True, eq=False, repr=False)
class Rendering(Picture, Frozen):
    """A picture drawn from a flat; as an array, its image.

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
        Standard deviation of the noise of a pixel of the flat in the light of white, if the detail
        was restored.
    encoded : bool, optional
        Whether values are encoded for a display, not in proportion to light; by default those of 8
        bits are.
    white_balance : (float, float, float), optional
        Of pictures of a colour filter mosaic: the gains of red, green and blue that make grey grey,
        as the white image tells; empty without a white image.

    Examples
    --------
    >>> import lfrender
    >>> flat, camera, depth = lfrender.data.example()
    >>> picture = lfrender.render(flat, camera, depth, scale=6)
    >>> picture.image.shape, picture.scale
    ((47, 62, 3), 6.0)
    >>> (picture.affine @ [0, 0, 1]).round().tolist()  # where the first pixel lies on the flat
    [1.0, 1.0]
    >>> picture.shape, picture[10:20, 5].shape  # as an array
    ((47, 62, 3), (10, 3))
    >>> picture.save("picture.png")  # doctest: +SKIP
    """

    image: Array
    affine: Floats
    valid: Booleans
    scale: float
    white: float | None = None
    noise: float | None = None
    encoded: bool | None = None
    white_balance: Triple | tuple[()] | None = None
    _layers = ("image", "valid")

    def save(self, path: AnyPath, **options: Any) -> None:
        """Write the picture to a file, as `lfrender.write_picture`, with its options and errors."""
        from .. import write_picture

        write_picture(path, self, **options)

    def plot(self, ax: Any = None) -> Any:
        """Draw the picture over scene coordinates, by default on the current axes; returns them.

        Linear pictures are shown by the curve of sRGB, dim ones brighter.
        """
        image = self.image
        gain = exposure_gain(image, self.white, None, self.encoded)
        image = to_eight_bits(image, self.white, gain, self.encoded)
        height, width = image.shape[:2]
        corners = self.affine @ [-0.5, -0.5, 1], self.affine @ [width - 0.5, height - 0.5, 1]
        look: Entries = {"cmap": "gray", "vmin": 0, "vmax": 255}
        shown = np.squeeze(image)
        title = f"{self.scale:.1f} px per pitch"
        return show_on_axes(ax, shown, *corners, title, **look).axes

    def __repr__(self) -> str:
        height, width = self.image.shape[:2]
        channels = 1
        if self.image.ndim == 3:
            channels = self.image.shape[2]
        size = f"{width} x {height} px, {channels} x {self.image.dtype}"
        return f"Rendering({size}, {self.scale:.4g} px per pitch, {np.mean(self.valid):.1%} seen)"

    def _repr_html_(self) -> str:
        return html_card(repr(self), {}, self.plot)


def scene_points(shape: Size, affine: Floats) -> Floats:
    """(h, w, 2) scene coordinates of the pixels of a picture of this shape (h, w)."""
    v, u = np.indices(shape)
    points: Floats = np.stack([u, v, np.ones_like(u)], -1) @ affine.T
    return points


def show_on_axes(ax: Any, image: Array, first: Array, last: Array, title: str, **look: Any) -> Any:
    """Draw a picture between two corners in scene coordinates, by default on the current axes."""
    import matplotlib.pyplot as plt

    ax = ax or plt.gca()
    ax.set(xlabel="x [flat px]", ylabel="y [flat px]", title=title)
    return ax.imshow(image, extent=(first[0], last[0], last[1], first[1]), **look)


def finish_picture(
    image: Array,
    valid: Booleans,
    affine: Floats,
    scale: float,
    flat: Array,
    calibration: Calibration,
) -> Rendering:
    """A picture (h, w, C) as a `Rendering` with the type and dimensions of the flat."""
    if np.ndim(flat) == 2 and image.shape[2:] == (1,):
        image = image[:, :, 0]
    dtype = np.asarray(flat).dtype
    balance = None
    if calibration.mosaic is not None and image.shape[2:] == (3,):
        balance = calibration.white_balance or ()
    return Rendering(
        convert_to_dtype(image, dtype),
        affine,
        valid,
        scale,
        calibration.white_level,
        encoded=is_encoded(dtype, calibration.encoded),
        white_balance=balance,
    )


def convert_to_dtype(image: Array, dtype: np.dtype) -> Array:
    """Round and clip to the range of `dtype`, in place."""
    if dtype.kind == "f" or image.dtype == dtype:
        return image.astype(dtype, copy=False)
    # As the kernels round: add a half and truncate.
    image += image.dtype.type(0.5)
    return np.clip(image, 0, np.iinfo(dtype).max, out=image).astype(dtype)
