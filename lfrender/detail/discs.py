"""The discs over which microlenses surely blur: those that the camera file tells.

A flat alone does not tell a soft scene from a blurred one, and undoing a blur that is not there makes rings.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration

from .settings import RESTORE, RestoreSettings

__all__ = ["sure_discs"]


def sure_discs(
    calibration: Calibration, ratios: NDArray[np.float64], settings: RestoreSettings = RESTORE
) -> NDArray[np.float64]:
    """(types, n) diameters [px of the flat] of the discs of defocus at these `s / D`, by lens type.

    Of several types, one is near its focus at any depth: what it is blurred by counts as the scene's.

    Examples
    --------
    >>> from lfcal import Lattice, LensBlur
    >>> blur = LensBlur(6.0, 1.2, [0.1], [0.1], [-0.3], [[2.4]], [[0.2]])
    >>> camera = Calibration(Lattice([10, 12], [[20, 0], [0, 20]], (200, 100), 9.5), lens_blur=blur)
    >>> sure_discs(camera, np.array([-0.25])).round(2)
    array([[2.23]])
    """
    types, known = calibration.lens_types, calibration.lens_blur
    count = 1 if types is None else types.count
    if known is None or len(known.focus) != count:
        return np.zeros((count, len(ratios)))
    order = np.argsort(known.ratios)
    least = np.maximum(known.discs - settings.doubt * known.disc_errors, 0)[:, order]
    discs = np.stack([np.interp(ratios, known.ratios[order], one) for one in least])
    own = discs.min(0) if count > 1 else 0.0
    return np.asarray(np.sqrt(discs**2 - own**2))
