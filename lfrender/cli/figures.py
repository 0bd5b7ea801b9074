"""The figures that commands print, and what is stored with a picture of how it was rendered."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from typing import Literal

    from lfcal import Calibration

    from ..data.depth_map import DepthMap
    from ..data.optics import Optics
    from ..data.rendering import Rendering

__all__ = ["camera_figures", "depth_figures", "distance_figures", "picture_figures", "settings_of"]

# Even of a scene that is mostly blank more lenses than this share have no depth only where something is wrong.
_NOTHING = 0.95
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


def camera_figures(calibration: Calibration, depth: DepthMap | None = None) -> dict[str, Any]:
    """Pitch, lenses, how far the calibration is to be trusted, and what to beware of in it and in the depth."""
    return {
        "pitch": calibration.lattice.pitch,
        "lenses": len(calibration.lattice),
        "camera_source": calibration.source,
        "camera_confidence": calibration.confidence,
        "warnings": [*calibration.warnings, *_warnings(depth)],
    }


def _warnings(depth: DepthMap | None) -> list[str]:
    if depth is None:
        return []
    import numpy as np

    from ..data.depth_map import REASONS

    # Nothing is wrong with lenses that nobody asked for.
    modes = np.asarray(depth.mode)[np.asarray(depth.reason) != REASONS.index("not analysed")]
    missing = float(np.mean(modes == 0)) if modes.size else 0.0
    if missing <= _NOTHING:
        return []
    return [f"{missing:.0%} of the lenses have no depth; is this a capture of a scene, and made with this camera?"]


def depth_figures(depth: DepthMap) -> dict[str, Any]:
    """Shares of the modes, why lenses are unresolved, and what shortcuts have saved."""
    import numpy as np

    mode = np.asarray(depth.mode)
    shares = {name: float(np.mean(mode == code)) for name, code in _MODES.items()} if mode.size else {}
    sizes = np.abs(np.asarray(depth.patch_size))[mode != 0]
    from ..data.depth_map import REASONS

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
