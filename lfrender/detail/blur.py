"""What blurs a picture: discs of microlenses, pixels of the flat, and interpolation.

A flat alone does not tell a soft scene from a blurred one, and undoing a blur that is not there
makes rings: detail is restored for both the smallest possible disc and the expected one. What is
left out of averages is the expected one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, LensBlur

from ..data.depth_map import DepthMap
from ..flat.lens_type_weights import type_shares

__all__ = [
    "averaged_squares",
    "choose_blur",
    "interpolation_transfer",
    "possible_discs",
    "shows_both_modes",
    "squares_to_average",
]

#: [pitch] Aperture of the microlenses where nothing tells it; ray-traced cameras have 0.14 to 0.5.
#: Of nine random scenes with true depth, coarse pictures lose 0.06 dB in the mean against the true
#: discs with 0.2, 0.07 with 0.22, 0.08 with 0.18.
_TYPICAL_APERTURE = 0.2
#: [s / D] Distance from focus of the types of a multi-focus array whose foci are not known: the
#: mean distance of a depth from three foci that are 0.11 to 0.17 apart.
_TYPICAL_DISTANCE = 0.13
#: [s / D] Microlenses are focused no farther from `s = 0`; wider rims mean wider apertures.
_FARTHEST_FOCUS = 0.5
#: Share of a surface that makes a scene lie on either side of `s = 0`.
_LEAST_SHARE = 0.05
#: [px^2] What interpolation averages beside the disc, which `prefilter_flat` does not undo at high
#: frequencies. Least squares as in `squares_to_average` need 0.2 to 0.6 with discs of 0 to 3.5 px.
_READING = 0.35
# Area of the square that blurs as a disc does, over the square of its diameter.
_OF_DISCS = 0.7


def choose_blur(calibration: Calibration, depth: DepthMap) -> LensBlur | None:
    """The blur of the camera file if it tells the aperture, else that of the depth map.

    It is None for another number of lens types, and for rims alone, which tell the discs at
    `s = 0` only.
    """
    types = calibration.lens_types
    known = calibration.lens_blur
    if known is None or (depth.lens_blur is not None and not known.tells_aperture):
        known = depth.lens_blur
    count = 1 if types is None else types.count
    if known is None or not known.ratios.any() or len(known.focus) != count:
        return None
    return known


def possible_discs(blur: LensBlur | None, ratios: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2, types, n) smallest and expected diameters [px of the flat] of discs at these `s / D`.

    They are zero without any measurement.
    """
    if blur is None:
        return np.zeros((2, 1, len(ratios)))
    discs, errors = blur.at(ratios)
    return np.stack([np.maximum(discs - errors, 0), discs])


def shows_both_modes(patch_size: NDArray[np.float32]) -> bool:
    """Whether a surface of these patch sizes lies on both sides of `s = 0`."""
    positive = float((patch_size > 0).mean())
    return _LEAST_SHARE < positive < 1 - _LEAST_SHARE


def _likely_discs(
    calibration: Calibration,
    blur: LensBlur | None,
    ratios: NDArray[np.float64],
    both_modes: bool,
) -> NDArray[np.float64]:
    """(types, n) expected or typical diameters [px of the flat] of the discs at these `s / D`."""
    if blur is not None:
        return blur.at(ratios)[0]
    types = calibration.lens_types
    away = np.abs(ratios)[None]
    if types is not None and types.count > 1:
        assert types.focus is not None
        away = np.abs(ratios - types.focus[:, None])
        away[np.isnan(away)] = _TYPICAL_DISTANCE
    aperture = _TYPICAL_APERTURE * calibration.lattice.pitch
    typical = aperture * away
    rims = calibration.lens_blur
    if rims is not None and len(rims.focus) == len(typical):
        edge, error = rims.at([0.0])
        known = edge > 2 * error
        widest = float(np.max(edge, where=known, initial=0.0))
        aperture = max(aperture, widest / _FARTHEST_FOCUS)
        away = aperture * np.abs(ratios)
        # Scenes lie on the side of `s = 0` where the microlenses are in focus. Of a scene on both
        # sides, nothing tells which one that is.
        likely = np.hypot(away, edge) if both_modes else np.abs(away - edge)
        typical = np.where(known, likely, typical)
    return typical


def averaged_squares(
    calibration: Calibration,
    blur: LensBlur | None,
    ratios: NDArray[np.float64],
    both_modes: bool = False,
) -> NDArray[np.float64]:
    """(n,) areas [px^2] of squares that blur as discs and reading do, at these `s / D`.

    With `both_modes`, the scene lies on both sides of `s = 0`.
    """
    discs = _likely_discs(calibration, blur, ratios, both_modes)
    shares = type_shares(calibration.lens_types, ratios, len(discs))
    return _OF_DISCS * (shares * discs**2).sum(0) + _READING


def squares_to_average(
    calibration: Calibration,
    blur: LensBlur | None,
    ratios: NDArray[np.float64],
    scale: float,
    both_modes: bool = False,
) -> NDArray[np.float64]:
    """Areas (n,) [px^2] of the flat that are averaged for an output pixel, at these `s / D`.

    They make the pixel of a picture of `scale` pixels per pitch the mean over its own area.

    Pixels, discs and reading have averaged the rest already. By least squares for scenes whose
    power falls with the third power of frequency, the square is `(L - v) (1 + v / 3 L)`: `L` is the
    pixel's own area less that of a pixel of the flat, and `v` that of `averaged_squares`. That was
    found for pixels of 1.2 to 8 px and discs up to 4 px.
    """
    averaged = averaged_squares(calibration, blur, ratios, both_modes)
    left = np.maximum((ratios * calibration.lattice.pitch / scale) ** 2 - 1, 1e-9)
    return np.maximum(left - averaged, 0) * (1 + averaged / (3 * left))


def interpolation_transfer(frequency: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transfer function of bilinear interpolation of a flat from `prefilter_flat`.

    The frequency is in cycles per pixel along one axis.
    """
    seen = np.minimum(np.abs(frequency), 1.0)
    return np.sinc(frequency) ** 2 * (1 + (1 - np.cos(2 * np.pi * seen)) / 6)
