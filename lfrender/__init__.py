"""Depth analysis and rendering of focused plenoptic flats."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .analysis import analyze
    from .demosaicing import demosaic
    from .depthmap import DepthMap
    from .drawing import default_scale, render
    from .lens_means import traditional
    from .picture import write_picture
    from .refocusing import focal_stack, refocus
    from .rendering import Rendering

__all__ = [
    "DepthMap",
    "Rendering",
    "analyze",
    "default_scale",
    "demosaic",
    "focal_stack",
    "refocus",
    "render",
    "traditional",
    "write_picture",
]

_HOMES = {
    "DepthMap": "depthmap",
    "Rendering": "rendering",
    "analyze": "analysis",
    "default_scale": "drawing",
    "demosaic": "demosaicing",
    "focal_stack": "refocusing",
    "refocus": "refocusing",
    "render": "drawing",
    "traditional": "lens_means",
    "write_picture": "picture",
}


def __getattr__(name: str) -> Any:
    # The kernels bring a compiler along: nobody should wait for it who only asks for help. No module may
    # bear the name of a function here, or importing the one would hide the other.
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(f".{_HOMES[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
