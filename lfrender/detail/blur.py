"""What blurs a picture: the discs of microlenses out of focus, the pixels of the flat, and reading
between them.

A flat alone does not tell a soft scene from a blurred one, and undoing a blur that is not there
makes rings: what is undone is the smallest disc that the camera file allows, what is left out of
averages is the likeliest one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration, LensBlur

from ..data.depth_map import DepthMap
from ..flat.lens_type_weights import type_shares

__all__ = [
    "READING",
    "TYPICAL_DISC",
    "choose_blur",
    "interpolation_transfer",
    "squares_to_average",
    "sure_discs",
]

#: [px] Disc of the largest patches where the camera file does not tell it: eleven ray-traced flats
#: have 2.4 to 6 px.
TYPICAL_DISC = 2.2
#: [px^2] The same for interpolation, which `prefilter_flat` does not undo at high frequencies;
#: discs hide it.
READING = 0.35


def choose_blur(calibration: Calibration, depth: DepthMap) -> LensBlur | None:
    """That of the camera file if it tells the aperture, else that of the depth map; None if it is
    not that of as many lens types.
    """
    types = calibration.lens_types
    known = calibration.lens_blur
    if known is None or (depth.lens_blur is not None and not known.tells_aperture):
        known = depth.lens_blur
    count = 1 if types is None else types.count
    return known if known is not None and len(known.focus) == count else None


def sure_discs(blur: LensBlur | None, ratios: NDArray[np.float64]) -> NDArray[np.float64]:
    """(types, n) diameters [px of the flat] of the discs of defocus at these `s / D`, less their
    standard errors.
    """
    if blur is None:
        return np.zeros((1, len(ratios)))
    discs, errors = blur.at(ratios)
    return np.maximum(discs - errors, 0)


def squares_to_average(
    calibration: Calibration,
    blur: LensBlur | None,
    ratios: NDArray[np.float64],
    scale: float,
    full: float,
) -> NDArray[np.float64]:
    """(n,) area [px^2] of the square of the flat that makes an output pixel the mean over its own
    area of the scene, of a picture of `scale` pixels per pitch, at these `s / D`.

    Pixels, discs and reading have averaged the rest already. By least squares for scenes whose
    power falls with the third power of frequency, the square is `(L - v) (1 + v / 3 L)`: `L` is the
    pixel's own area less that of a pixel of the flat, and `v` the area of the square that blurs as
    the discs do. That was found for pixels of 1.2 to 8 px and discs up to 4 px. `full` is the scale
    of the largest patches, whose disc is `TYPICAL_DISC` if nothing tells it.
    """
    pitch = calibration.lattice.pitch
    discs = np.abs(ratios)[None] * (TYPICAL_DISC * pitch / full)
    if blur is not None:
        found, errors = blur.at(ratios)
        discs = np.where(errors < TYPICAL_DISC / 2, found, discs)
    shares = type_shares(calibration.lens_types, ratios, len(discs))
    averaged = np.maximum(0.7 * (shares * discs**2).sum(0), READING)
    left = np.maximum((ratios * pitch / scale) ** 2 - 1, 1e-9)
    return np.asarray(np.maximum(left - averaged, 0) * (1 + averaged / (3 * left)))


def interpolation_transfer(frequency: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transfer function, at cycles per pixel along one axis, of bilinear interpolation of a flat
    from `prefilter_flat`.
    """
    seen = np.minimum(np.abs(frequency), 1.0)
    return np.asarray(np.sinc(frequency) ** 2 * (1 + (1 - np.cos(2 * np.pi * seen)) / 6))
