"""The figures that commands print, and what is stored with a picture of how it was rendered."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from typing import Literal

    from lfcal import Calibration

    from .depthmap import DepthMap
    from .optics import Optics
    from .rendering import Rendering

__all__ = ["camera_figures", "depth_figures", "distance_figures", "picture_figures", "settings_of"]

_MODES = {"telescopic": 1, "binocular": -1, "unresolved": 0}


def settings_of(
    depth: DepthMap | None, patch_size: float | None, sharpen: float | Literal["auto"] | None = None
) -> dict[str, Any]:
    """How a picture was rendered, as stored in its file."""
    sharpened = {} if sharpen is None else {"sharpen": sharpen}
    if depth is not None:
        return {"rendering": "all in focus", "preset": depth.preset, **sharpened}
    if patch_size is not None:
        return {"rendering": "one patch size", "patch_size": patch_size, **sharpened}
    return {"rendering": "traditional"}


def camera_figures(calibration: Calibration) -> dict[str, Any]:
    """Pitch, lenses, and how far the calibration is to be trusted."""
    return {
        "pitch": calibration.lattice.pitch,
        "lenses": len(calibration.lattice),
        "camera_source": calibration.source,
        "camera_confidence": calibration.confidence,
        "warnings": list(calibration.warnings),
    }


def depth_figures(depth: DepthMap) -> dict[str, Any]:
    """Shares of the modes, why lenses are unresolved, and what shortcuts have saved."""
    import numpy as np

    mode = np.asarray(depth.mode)
    shares = {name: float(np.mean(mode == code)) for name, code in _MODES.items()} if mode.size else {}
    sizes = np.abs(np.asarray(depth.patch_size))[mode != 0]
    from .depthmap import REASONS

    return {
        "modes": shares,
        "patch_size_median": float(np.median(sizes)) if sizes.size else float("nan"),
        "unresolved": {
            REASONS[code]: float(np.mean(depth.reason == code)) for code in np.unique(depth.reason[mode == 0])
        },
        "saved": depth.saved,
    }


def distance_figures(depth: DepthMap, optics: Optics | None) -> dict[str, Any]:
    """Nearest, middle and farthest distance [m] of nine tenths of the lenses, where the optics are known."""
    if optics is None:
        return {}
    import numpy as np

    known = depth.distance(optics)
    known = known[~np.isnan(known)]
    low, median, high = np.quantile(known, (0.05, 0.5, 0.95), method="nearest") if known.size else [float("nan")] * 3
    return {"distance_median": float(median), "distance_range": [float(low), float(high)]}


def picture_figures(picture: Rendering) -> dict[str, Any]:
    """Size, scale, and where the picture lies on the flat."""
    import numpy as np

    return {
        "size": [picture.image.shape[1], picture.image.shape[0]],
        "scale": picture.scale,
        "valid": float(np.mean(picture.valid)),
        "affine": picture.affine,
    }
