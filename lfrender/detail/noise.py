"""The noise of a flat's pixels, in light, estimated from the smoothest microimages.

Second differences along both axes contain noise alone where light changes evenly (J. Immerkaer
1996). The microimages with the smallest ones show the least of the scene.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lfcal import Calibration
from lfcal.runtime.arrays import evenly

from ..flat.gray_flat import grey_light, trusted_radius

__all__ = ["DARKEST", "Look", "measure_noise"]

#: Light [white] below which the variance of noise falls no further.
DARKEST = 0.01
# Share of the quietest microimages that shows the noise.
_QUIETEST = 0.1
#: Pixels (h, w, C) of the part `left, top, right, bottom` of a flat.
Look = Callable[[tuple[int, int, int, int]], NDArray]


def measure_noise(look: Look, calibration: Calibration) -> float:
    """Standard deviation of a pixel's mean over the channels in the light of white [white]; 0 if no
    lens is whole.

    Its variance is in proportion to light, a hundredth of white at least; the quietest tenth of a
    hundred microimages shows it. Half the noise moves pictures by 0.01 dB, twice by 0.03.
    """
    lattice = calibration.lattice
    half = int(np.clip(trusted_radius(calibration) / np.sqrt(2), 2, 5))
    centres = np.rint(lattice.centres()).astype(int)
    inside = ((centres >= half) & (centres < np.array(lattice.image_size) - half)).all(1)
    some = centres[inside][evenly(int(inside.sum()), 100)]
    if not len(some):
        return 0.0
    boxes = np.stack(
        [look((x - half, y - half, x + half + 1, y + half + 1)) for x, y in some.tolist()]
    )
    grey = grey_light(boxes, calibration)
    rough = np.diff(np.diff(grey, 2, 1), 2, 2)
    # The sum of the squared weights of both second differences.
    variance = (rough**2).mean((1, 2)) / 6**2 / np.maximum(grey.mean((1, 2)), DARKEST)
    return float(np.sqrt(np.quantile(variance, _QUIETEST)))
