"""A camera whose flat was taken through a wider aperture of the main lens than its white image."""

from __future__ import annotations

from dataclasses import replace

from numpy.typing import ArrayLike

from ..camera.calibration import Calibration
from ..gain.gain_map import nearest_half
from ..images.mosaic import equalise_mosaic, remove_mosaic
from ..images.preprocessing import sqrt_luminance
from ..images.stack import check_flats
from ..runtime.errors import CAMERA_ADVICE, CalibrationError, FlatError, check_type
from .measure import measure_illumination

__all__ = ["widen_microimages"]

# [half the distance to the nearest microimage] Cameras of this radius have no room for wider
# microimages.
_WIDE = 0.9
# Radius on a flat over that of its camera above which the aperture differs. Both agree within 2 %
# on four captures with white images, and within 7 % on a dim one.
_WIDER = 1.1


def widen_microimages(calibration: Calibration, flat: ArrayLike) -> Calibration:
    """The camera with the radius and gain map of a flat whose microimages are wider than its own.

    The main lens's aperture sets the size of the microimages. A white image through a closed
    aperture has small ones, which place the lattice well; with their radius most of a flat through
    an open aperture would not be drawn.

    Parameters
    ----------
    calibration : Calibration
        A camera. If its microimages nearly touch, it is returned as it is.
    flat : (h, w) or (h, w, 3) array_like
        A capture of the same camera, through another aperture of the main lens.

    Returns
    -------
    Calibration
        The same object unless the microimages of the flat have a radius larger by a tenth or more;
        also if too little light is on the flat to measure it.

    Raises
    ------
    FlatError
        If the flat is none, or has another size than those of the camera.

    Examples
    --------
    >>> import lfcal
    >>> import numpy as np
    >>> y, x = np.mgrid[:240, :300]
    >>> distance = np.hypot((x - 9) % 20 - 10, (y - 6) % 20 - 10)
    >>> noise = np.random.default_rng(0).normal(20, 2, x.shape)
    >>> closed, wide = (200 * np.clip(radius - distance, 0, 1) + noise for radius in (5.5, 9.5))
    >>> camera = lfcal.calibrate(closed)
    >>> wider = lfcal.widen_microimages(camera, wide)
    >>> round(camera.lattice.radius), round(wider.lattice.radius)
    (5, 9)
    """
    check_type(calibration, Calibration, "calibration", CAMERA_ADVICE)
    (pixels,) = check_flats([flat])
    if pixels.shape[1::-1] != calibration.image_size:
        own = "{} x {} px".format(*calibration.image_size)
        raise FlatError(f"flat has shape {pixels.shape}, the camera is for {own}; give its flat")
    lattice = calibration.lattice
    radius = lattice.radius
    if radius >= _WIDE * nearest_half(lattice):
        return calibration
    if calibration.mosaic is not None and pixels.ndim == 2:
        pixels = remove_mosaic(equalise_mosaic(pixels))
    try:
        light = measure_illumination(sqrt_luminance(pixels), lattice, white=False)
    except CalibrationError:
        return calibration
    if light.radius < _WIDER * radius:
        return calibration
    warning = (
        f"microimages of the flat have a radius of {light.radius:.1f} px, those of the camera "
        f"{radius:.1f} px: the aperture of the main lens was wider; radius and gain are measured "
        "on the flat"
    )
    return replace(
        calibration,
        lattice=lattice.with_radius(light.radius),
        vignetting=light.vignetting,
        gain_map=light.gain_map,
        warnings=(*calibration.warnings, warning),
    )
