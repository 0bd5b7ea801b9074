"""What a scene capture shows of how a camera is set up: whether the array has moved, modes, depth, focus of types."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..display.fit_check import check_camera, check_fit
from ..images.preprocessing import sqrt_luminance
from ..lens_types.classify import find_lens_types
from ..lens_types.coarse_disparity import estimate_coarse_disparity
from ..lens_types.lens_sample import sample_lenses
from .findings import find_exposure, unmeasured
from .result import Finding

__all__ = ["assess_scene"]

# Spacing of the disparities that are tried [s / D].
_STEP = 0.05


def assess_scene(scene: NDArray[Any], camera: Calibration) -> dict[str, Finding]:
    """Findings on a scene, given the camera as its white image shows it."""
    found = {"place": _find_shift(scene, camera), "exposure": find_exposure(scene, camera)}
    return found | {"depth": _find_depth(scene, camera)} | _find_focus(scene, camera)


def _find_shift(scene: NDArray[Any], camera: Calibration) -> Finding:
    check, fit = check_camera(camera, scene), check_fit(camera, scene)
    # What is shown in microimages moves the fit.
    error = fit.limit / 2
    if not check.checked or np.isnan(fit.max_offset):
        return unmeasured("px", check.problem or "the scene does not show where its microimages are")
    if check.problem is not None or fit.warning is not None:
        return Finding(fit.max_offset, error, "px", check.problem or fit.warning or "", "take a new white image")
    return Finding(fit.max_offset, error, "px", "the microimages are where the white image has them")


def _find_depth(scene: NDArray[Any], camera: Calibration) -> Finding:
    lattice = camera.lattice
    ratio = estimate_coarse_disparity(sqrt_luminance(scene), sample_lenses(lattice))
    known = ratio[np.isfinite(ratio)]
    if len(known) < 100:
        return unmeasured("s / D", "too few lenses show how far they differ from their neighbours")
    low, middle, high = np.quantile(known, (0.02, 0.5, 0.98))
    telescopic, binocular = (float((way * known > 1.5 * _STEP).mean()) for way in (1, -1))
    share = {"telescopic": telescopic, "binocular": binocular, "resolved": len(known) / len(ratio)}
    details = {"from": float(low), "to": float(high), **share}
    verdict = (
        f"s from {low:+.2f} D to {high:+.2f} D, {telescopic:.0%} telescopic and {binocular:.0%} binocular, seen "
        f"coarsely in {share['resolved']:.0%} of the lenses; 'lfrender analyze' measures each"
    )
    return Finding(float(middle), _STEP / 2, "s / D", verdict, details=details)


def _find_focus(scene: NDArray[Any], camera: Calibration) -> dict[str, Finding]:
    """Where each lens type is in focus, if there are several and the scene has depth."""
    if camera.lens_types is None:
        return {}
    types = find_lens_types(sqrt_luminance(scene), camera.lattice, False)
    focus = None if types is None or types.count != camera.lens_types.count else types.focus
    if focus is None or not np.isfinite(focus).all():
        return {"focus": unmeasured("s / D", "the scene has too little detail at several depths")}
    told = " / ".join(f"{one:+.2f}" for one in focus)
    return {"focus": Finding(float(focus.mean()), _STEP, "s / D", f"the lens types are sharpest at s = {told} D")}
