"""Depth analysis and rendering of focused plenoptic flats."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .analysis import analyze
    from .batch import render_frames
    from .cluster import render_frames_on
    from .demosaicing import demosaic
    from .depthmap import DepthMap
    from .drawing import default_scale, render
    from .films import render_film
    from .fourier_slice import refocus_fourier
    from .frame_job import FrameResult
    from .frames import Frames, open_frames
    from .large_analysis import analyze_large
    from .large_rendering import LargePicture, render_large
    from .lens_means import traditional
    from .optics import Optics
    from .picture import write_picture, write_stack
    from .plotting import napari_layers
    from .refocusing import focal_stack, refocus, stack_depths
    from .rendering import Rendering
    from .report_page import write_report
    from .view_files import stereo_pair, write_animation, write_grid
    from .viewer_page import write_viewer
    from .viewpoints import circle_offsets, grid_offsets, views

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
    "DepthMap": "depthmap",
    "FrameResult": "frame_job",
    "Frames": "frames",
    "LargePicture": "large_rendering",
    "Optics": "optics",
    "Rendering": "rendering",
    "analyze": "analysis",
    "analyze_large": "large_analysis",
    "circle_offsets": "viewpoints",
    "default_scale": "drawing",
    "demosaic": "demosaicing",
    "focal_stack": "refocusing",
    "grid_offsets": "viewpoints",
    "napari_layers": "plotting",
    "open_frames": "frames",
    "refocus": "refocusing",
    "refocus_fourier": "fourier_slice",
    "render": "drawing",
    "render_film": "films",
    "render_frames": "batch",
    "render_frames_on": "cluster",
    "render_large": "large_rendering",
    "stack_depths": "refocusing",
    "stereo_pair": "view_files",
    "traditional": "lens_means",
    "views": "viewpoints",
    "write_animation": "view_files",
    "write_grid": "view_files",
    "write_picture": "picture",
    "write_report": "report_page",
    "write_stack": "picture",
    "write_viewer": "viewer_page",
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
