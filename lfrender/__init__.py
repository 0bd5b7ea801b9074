"""Depth analysis and rendering of focused plenoptic flats.

These are the public names; others are reached by the sub-packages that `docs/architecture.md`
shows.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lfcal import Optics as Optics

    from .data.depth_map import DepthMap
    from .data.rendering import Rendering
    from .depth.analyze import analyze
    from .large.analyze import analyze_large
    from .large.render import render_large
    from .output.picture import write_picture
    from .rendering.refocus import focal_stack, refocus
    from .rendering.render import render
    from .rendering.traditional import traditional
    from .rendering.viewpoints import views
    from .sequence.film import render_frames
    from .sequence.frames import open_frames
    from .volume.microscope import Microscope
    from .volume.reconstruct import reconstruct_volume
    from .volume.volume import Volume

__all__ = [
    "DepthMap",
    "Microscope",
    "Rendering",
    "Volume",
    "analyze",
    "analyze_large",
    "focal_stack",
    "open_frames",
    "reconstruct_volume",
    "refocus",
    "render",
    "render_frames",
    "render_large",
    "traditional",
    "views",
    "write_picture",
]

_HOMES = {
    "DepthMap": "data.depth_map",
    "Microscope": "volume.microscope",
    "Optics": "lfcal",  # documented there
    "Rendering": "data.rendering",
    "Volume": "volume.volume",
    "analyze": "depth.analyze",
    "analyze_large": "large.analyze",
    "dense_depth": "data.dense_depth",  # documented there
    "focal_stack": "rendering.refocus",
    "open_frames": "sequence.frames",
    "reconstruct_volume": "volume.reconstruct",
    "refocus": "rendering.refocus",
    "render": "rendering.render",
    "render_frames": "sequence.film",
    "render_large": "large.render",
    "traditional": "rendering.traditional",
    "views": "rendering.viewpoints",
    "write_picture": "output.picture",
}


def __getattr__(name: str) -> Any:
    # Imported at first use: the compiler behind the kernels takes a second to load, which `--help`
    # does not need. No module may bear the name of a function here, or importing the one would hide
    # the other.
    if name == "data":
        from importlib import import_module

        return import_module(".data", __name__)
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    home = _HOMES[name]

    value = getattr(import_module(home if home == "lfcal" else f".{home}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
