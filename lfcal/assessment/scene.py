"""What a scene shows of a camera: position of the array, exposure, focus of lens types."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..display.camera_check import check_camera
from ..display.fit_check import check_fit
from ..images.preprocessing import sqrt_luminance
from ..lens_types.classify import find_lens_types
from ..lens_types.coarse_disparity import STEP
from .findings import unmeasured
from .light_findings import find_exposure
from .result import Finding

__all__ = ["assess_scene"]


def assess_scene(scene: NDArray[Any], camera: Calibration, top: float | None) -> dict[str, Finding]:
    """Assess a scene with the camera that its white image shows.

    `top` is the largest value that pixels can have, as for `find_exposure`.
    """
    found = {"place": _find_shift(scene, camera), "exposure": find_exposure(scene, top)}
    picture = sqrt_luminance(scene)
    types = camera.lens_types
    if types is not None:
        again = find_lens_types(picture, camera.lattice, False)
        focus = None if again is None or again.count != types.count else again.focus
        # Where each lens type is in focus, if the scene has depth.
        if focus is None or not np.isfinite(focus).all():
            found["focus"] = unmeasured(
                "s / D", "the scene has too little detail at several depths"
            )
        else:
            verdict = (
                f"the lens types are sharpest at s = {' / '.join(f'{one:+.2f}' for one in focus)} D"
            )
            found["focus"] = Finding(float(focus.mean()), STEP, "s / D", verdict)
    return found


def _find_shift(scene: NDArray[Any], camera: Calibration) -> Finding:
    check = check_camera(scene, camera)
    fit = check_fit(camera, scene)
    if not check.checked or np.isnan(fit.max_offset):
        return unmeasured(
            "px", check.problem or "the scene does not show where its microimages are"
        )
    problem = check.problem or fit.warning
    verdict = problem or "the microimages are where the white image has them"
    # What is shown in microimages moves the fit.
    return Finding(
        fit.max_offset, fit.limit / 2, "px", verdict, "take a new white image" if problem else ""
    )
