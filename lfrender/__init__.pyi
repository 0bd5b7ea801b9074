from . import data as data
from .data.dense_depth import dense_depth as dense_depth
from .data.depth_map import DepthMap
from .data.depth_map import Optics as Optics
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
