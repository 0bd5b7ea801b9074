"""Whether a calibration fits the pixels of a flat, measured on nine regions of it.

Camera files of other programs contradict themselves at times: the pixels decide.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..camera.calibration import Calibration
from ..gain.gain_map import RegionGain
from ..runtime.errors import FlatError
from .settings import FIT_CHECK

__all__ = ["FitCheck", "check_fit"]

_REGION_NAMES = (
    ("top left corner", "middle of the top edge", "top right corner"),
    ("middle of the left edge", "middle", "middle of the right edge"),
    ("bottom left corner", "middle of the bottom edge", "bottom right corner"),
)


@dataclass(frozen=True)
class FitCheck:
    """Centres measured on nine regions of a flat, against those of a given lattice.

    Parameters
    ----------
    positions : (3, 3, 2) float64 [px]
        Middles of the regions, in rows from the top.
    offset : (3, 3, 2) float64 [px]
        From the given centres to the measured ones, at most about half a pitch; NaN where a region shows none.
    scatter : (3, 3) float64 [px]
        Difference of the offsets measured on two halves of the lenses of a region.
    trend : (3, 3, 2) float64 [px]
        Shift, scale and shear fitted robustly to the offsets, as scenes disturb single regions. NaN where fewer than
        five regions show centres.
    pitch : float [px]
        Of the given lattice.

    Examples
    --------
    >>> import lfcal, lfrender
    >>> sample = lfrender.data.house(size=(400, 300), samples=2)
    >>> check = lfcal.check_fit(sample.truth.calibration, sample.white)
    >>> bool(check.max_offset < 0.5), check.warning
    (True, None)
    """

    positions: NDArray[np.float64]
    offset: NDArray[np.float64]
    scatter: NDArray[np.float64]
    trend: NDArray[np.float64]
    pitch: float

    @property
    def max_offset(self) -> float:
        """Longest offset of the trend [px], NaN where it is unknown."""
        return float(np.linalg.norm(self.trend, axis=-1).max())

    @property
    def limit(self) -> float:
        """Offset [px] up to which not to worry: no picture shows it, or single regions differ as much."""
        rest = np.linalg.norm(self.offset - self.trend, axis=-1)
        return max(FIT_CHECK.warning_offset * self.pitch, FIT_CHECK.warning_significance * float(np.nanmedian(rest)))

    @property
    def verdict(self) -> str:
        """Whether to worry, and why, in a sentence."""
        if np.isnan(self.max_offset):
            return "too few regions of this flat show where their microimages are; a white image would"
        if self.warning is not None:
            return f"{self.warning}, which pictures show: calibrate on this flat"
        return (
            f"within {self.max_offset:.2f} px of this flat; no reason to worry: what the scene shows in microimages "
            f"moves such figures, and pictures show nothing below {self.limit:.1f} px"
        )

    @property
    def warning(self) -> str | None:
        """What is wrong with the lattice where pictures would show it, else None."""
        if np.isnan(self.max_offset):
            return None
        if not self.max_offset > self.limit:
            return None
        row, column = np.unravel_index(int(np.linalg.norm(self.trend, axis=-1).argmax()), (3, 3))
        return f"the lattice is off by up to {self.max_offset:.1f} px in the {_REGION_NAMES[row][column]}"


def check_fit(calibration: Calibration, image: ArrayLike) -> FitCheck:
    """Measure on nine regions of a flat how far the microimages are from the centres of `calibration`.

    Parameters
    ----------
    calibration : Calibration
    image : (h, w) or (h, w, 3) array_like
        A white image or any scene capture of this camera.

    Raises
    ------
    FlatError
        If the image is not of the size the calibration is for.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal import Calibration, Lattice, check_fit
    >>> y, x = np.mgrid[:300, :400]
    >>> white = np.exp(-((x % 20 - 10) ** 2 + (y % 20 - 10.0) ** 2) / 40)
    >>> round(check_fit(Calibration(Lattice([11, 10], [[20, 0], [0, 20]], (400, 300), 9)), white).max_offset)
    1
    """
    from .region_offsets import Region, Trend, measure_offsets

    flat = np.asarray(image)
    width, height = calibration.image_size
    if flat.ndim not in (2, 3) or flat.shape[:2] != (height, width):
        raise FlatError(
            f"image has shape {flat.shape}; the calibration is for flats of {width} x {height} px, give one of its size"
        )
    lattice = calibration.lattice
    side = int(max(FIT_CHECK.smallest_region, FIT_CHECK.region * lattice.pitch))
    across, down = min(side, max(width // 3, 1)), min(side, max(height // 3, 1))
    corners = [
        (x, y) for y in (0, (height - down) // 2, height - down) for x in (0, (width - across) // 2, width - across)
    ]
    positions = np.array(corners) + (np.array([across, down]) - 1) / 2
    regions = [Region.cut(flat[y : y + down, x : x + across], lattice, x, y) for x, y in corners]
    offset, scatter, trend = measure_offsets(regions, positions)
    gain = calibration.gain_map
    if gain is not None and len(gain.cut):
        # Mechanical vignetting moves rims: offsets that the gain map shows as well are no misfit.
        bands = {y: np.nan_to_num(RegionGain(gain, lattice).at(0, y, width, down)) for _, y in corners}
        own = [Region.cut(bands[y][:, x : x + across], lattice, x, y) for x, y in corners]
        offset = offset - np.nan_to_num(measure_offsets(own, positions)[0])
        trend = Trend.fit(positions, offset, scatter, trend)
    known = np.isfinite(scatter).sum() >= FIT_CHECK.least_regions
    common = trend.at(positions) if known else np.full((9, 2), np.nan)
    return FitCheck(
        positions.reshape(3, 3, 2),
        offset.reshape(3, 3, 2),
        scatter.reshape(3, 3),
        common.reshape(3, 3, 2),
        lattice.pitch,
    )
