"""The figures that commands print, and the settings stored with a picture."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ..runtime.types import Entries

if TYPE_CHECKING:
    from lfcal import Calibration, Optics
    from lfcal.runtime.arrays import Array

    from ..data.depth_map import DepthMap
    from ..data.rendering import Rendering

__all__ = [
    "capture_figures",
    "capture_sentences",
    "few_pixels_problem",
    "percent",
    "picture_figures",
    "picture_sentence",
    "rendering_settings",
]

# Below this pitch [px] most lenses of a scene of several depths were left unresolved (HCI antinous,
# 9 px: 76 %).
_FEW_PIXELS = 12
# Shares below this are 0.0 % with the digits that are printed, and are left out.
_SMALLEST_SHARE = 0.0005


def rendering_settings(
    depth: DepthMap | None, patch_size: float | None, detail: str | None = None
) -> Entries:
    """How a picture was rendered, as stored in its file."""
    settings: Entries = {"rendering": "traditional"}
    if depth is not None:
        settings = {"rendering": "all in focus", "preset": depth.preset}
    elif patch_size is not None:
        settings = {"rendering": "one patch size", "patch_size": patch_size}
    if detail is not None:
        settings["detail"] = detail
    return settings


def capture_figures(
    calibration: Calibration, depth: DepthMap | None = None, optics: Optics | None = None
) -> Entries:
    """Figures of the camera and warnings; with a depth map, those of analysed lenses.

    These are shares of the modes, of the reasons why some are unresolved, and of the work that
    shortcuts saved; with optics, median and range [m] of the distances of nine tenths of the
    lenses, and the median of their standard errors.
    """
    figures: Entries = {
        "pitch": calibration.lattice.pitch,
        "lenses": len(calibration.lattice),
        "camera_source": calibration.source,
        "camera_confidence": calibration.confidence,
        "warnings": list(calibration.warnings),
    }
    if depth is None:
        return figures
    import numpy as np

    from ..data.depth_map import MODES, REASONS, finite
    from ..rendering.traditional import find_depth_problem

    problems = (few_pixels_problem(calibration.lattice.pitch), find_depth_problem(depth))
    figures["warnings"] += filter(None, problems)
    analysed = depth.reason != REASONS.index("not analysed")
    mode = depth.mode[analysed]
    reason = depth.reason[analysed]
    figures |= {
        "lenses_analysed": int(analysed.sum()),
        "modes": {name: float(np.mean(mode == code)) for code, name in MODES.items() if len(mode)},
        "patch_size_median": _median(np.abs(finite(depth.patch_size))),
        "unresolved": {
            REASONS[code]: float(np.mean(reason == code)) for code in np.unique(reason[mode == 0])
        },
        "saved": depth.saved,
    }
    if optics is None:
        return figures
    from lfcal.runtime.arrays import NINE_TENTHS

    camera = calibration if optics is calibration.optics else optics
    known = depth.distance(camera)
    known = known[~np.isnan(known)]
    low = middle = high = math.nan
    if known.size:
        low, middle, high = np.quantile(known, NINE_TENTHS, method="nearest").tolist()
    error = _median(finite(depth.distance_error(camera)))
    distances = {"distance_median": middle, "distance_range": [low, high], "distance_error": error}
    return figures | distances


def _median(values: Array) -> float:
    """The median, NaN of no values."""
    import numpy as np

    return float(np.median(values)) if values.size else math.nan


def few_pixels_problem(pitch: float) -> str | None:
    """Warning about an array whose microimages are too small for matching; None if they are not."""
    if pitch >= _FEW_PIXELS:
        return None
    return (
        f"microimages of {pitch:.0f} px are small for depth from neighbouring lenses: many lenses "
        "may be unresolved or wrong; for a grid of views use a program that matches views"
    )


def picture_figures(picture: Rendering) -> Entries:
    """Size, scale, share of valid pixels, and affine to the flat."""
    height, width = picture.image.shape[:2]
    valid = float(picture.valid.mean())
    return {
        "size": [width, height],
        "scale": picture.scale,
        "valid": valid,
        "affine": picture.affine,
    }


def percent(share: float) -> str:
    """A share in percent, with a digit behind the point only where it would be 0 or 100 without."""
    rounded = f"{100 * share:.0f}"
    if rounded in ("0", "100") and share not in (0.0, 1.0):
        rounded = f"{100 * share:.1f}"
    return f"{rounded} %"


def capture_sentences(how: str, found: Entries) -> list[str]:
    """Sentences about the figures of `capture_figures`.

    These are number and pitch of the lenses, `how` they were found, shares of the modes, distances.
    """
    sentences = [f"{found['lenses']:,} microlenses, {found['pitch']:.1f} px apart, {how}."]
    if "modes" not in found:
        return sentences
    count = found["lenses_analysed"]
    where = "lenses"
    if count < found["lenses"]:
        where = f"{count:,} lenses in this part"
    told = {n: share for n, share in found["modes"].items() if share >= _SMALLEST_SHARE}
    shares = ", ".join(f"{percent(share)} {name}" for name, share in told.items())
    if "unresolved" in told:
        # The reasons of a quarter of the unresolved lenses or more.
        least = told["unresolved"] / 4
        reasons = found["unresolved"].items()
        shares += f" ({' or '.join(name for name, part in reasons if part >= least)})"
    sentences.append(f"Of the {where} {shares}.")
    middle = found.get("distance_median", math.nan)
    if not math.isnan(middle):
        near, far = found["distance_range"]
        sentences.append(
            f"Distances {near:.3g} to {far:.3g} m, half of them below {middle:.3g} m, each to "
            f"{found['distance_error']:.2g} m."
        )
    return sentences


def picture_sentence(path: Any, picture: Rendering, what: str, took: str) -> str:
    """A sentence about a picture file: name, size, content, seconds."""
    height, width = picture.image.shape[:2]
    sentence = f"{path}: {width} x {height} px, {what}, in {took}"
    unseen = 1 - float(picture.valid.mean())
    if unseen > _SMALLEST_SHARE:
        sentence += f"; {percent(unseen)} of it seen by no lens"
    return f"{sentence}."
