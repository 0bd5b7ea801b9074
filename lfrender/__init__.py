"""Depth analysis and rendering of focused plenoptic flats."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .data.depth_map import DepthMap
    from .data.optics import Optics
    from .data.plots import napari_layers
    from .data.rendering import Rendering
    from .depth.analyze import analyze
    from .flat.demosaicing import demosaic
    from .large.analyze import analyze_large
    from .large.render import LargePicture, render_large
    from .output.picture import write_picture, write_stack
    from .output.views import stereo_pair, write_animation, write_grid
    from .rendering.fourier_slice import refocus_fourier
    from .rendering.refocus import focal_stack, refocus, stack_depths
    from .rendering.render import default_scale, render
    from .rendering.traditional import traditional
    from .rendering.viewpoints import circle_offsets, grid_offsets, views
    from .sequence.batch import render_frames
    from .sequence.cluster import render_frames_on
    from .sequence.film import render_film
    from .sequence.frames import Frames, open_frames
    from .sequence.job import FrameResult
    from .web.report import write_report
    from .web.viewer import write_viewer

__all__ = [
    "DepthMap",
    "FrameResult",
    "Frames",
    "LargePicture",
    "Optics",
    "Rendering",
    "analyze",
    "analyze_large",
    "circle_offsets",
    "default_scale",
    "demosaic",
    "focal_stack",
    "grid_offsets",
    "napari_layers",
    "open_frames",
    "refocus",
    "refocus_fourier",
    "render",
    "render_film",
    "render_frames",
    "render_frames_on",
    "render_large",
    "stack_depths",
    "stereo_pair",
    "traditional",
    "views",
    "write_animation",
    "write_grid",
    "write_picture",
    "write_report",
    "write_stack",
    "write_viewer",
]

_HOMES = {
    "DepthMap": "data.depth_map",
    "FrameResult": "sequence.job",
    "Frames": "sequence.frames",
    "LargePicture": "large.render",
    "Optics": "data.optics",
    "Rendering": "data.rendering",
    "analyze": "depth.analyze",
    "analyze_large": "large.analyze",
    "circle_offsets": "rendering.viewpoints",
    "default_scale": "rendering.render",
    "demosaic": "flat.demosaicing",
    "focal_stack": "rendering.refocus",
    "grid_offsets": "rendering.viewpoints",
    "napari_layers": "data.plots",
    "open_frames": "sequence.frames",
    "refocus": "rendering.refocus",
    "refocus_fourier": "rendering.fourier_slice",
    "render": "rendering.render",
    "render_film": "sequence.film",
    "render_frames": "sequence.batch",
    "render_frames_on": "sequence.cluster",
    "render_large": "large.render",
    "stack_depths": "rendering.refocus",
    "stereo_pair": "output.views",
    "traditional": "rendering.traditional",
    "views": "rendering.viewpoints",
    "write_animation": "output.views",
    "write_grid": "output.views",
    "write_picture": "output.picture",
    "write_report": "web.report",
    "write_stack": "output.picture",
    "write_viewer": "web.viewer",
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
