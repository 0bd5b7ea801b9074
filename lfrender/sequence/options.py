"""How the frames of a sequence are rendered: one record for functions and commands."""

from __future__ import annotations

from dataclasses import dataclass

from lfcal.runtime.light.tone import Exposure, WhiteBalance

from ..runtime.choices import Preset, Tone
from ..runtime.types import AnyPath, Size
from .view_grid import ViewGrid

__all__ = ["FrameOptions"]


@dataclass(frozen=True)
class FrameOptions:
    """Options of `render_frames` and `render_film`, which also take each of them as a keyword.

    Parameters
    ----------
    preset : {"fast", "balanced"}
    scale : float or None
        Output pixels per pitch. None takes the full resolution of the first frame for all frames.
    size : (int, int), optional [px]
        Width and height of the pictures, or of each view, in place of `scale`.
    suffix : str
        Format of the pictures: `".tif"`, `".png"`, ... Films ignore it.
    views : ViewGrid, optional
        Views of a grid instead of one picture. They are written as raw video, one file per view
        (`v000-1920x1080.yuv`, ...), if `suffix` is `".yuv"` or a pixel format such as
        `".yuv444p12"`; otherwise as one folder per frame (`FRAME/image_001.png`, ...). Raw video
        appears after the last result has been taken. A frame that fails repeats the frame before.
    eight_bits : bool
        Write pictures with 8 bits per channel. JPEG and WebP always have 8 bits.
    exposure : float or "auto", optional [EV]
        As for `write_picture`. All pictures have one gain; `"auto"` measures it on the first frame.
    tone, white_balance, quality
        As for `write_picture`; the white balance of all pictures is that of the first frame.
    shown_as : str
        Suffix of the format that decides what `"auto"` means for the three above, such as `".mp4"`;
        by default that of the pictures. `render_film` sets it.
    depth_maps : path-like, optional
        Folder for the depth map of each frame (`FRAME.npz`), or a film of depth pictures in the
        colours of `lfrender analyze --picture`, on one scale for all frames.
    rate : float, optional
        Pictures per second of a film. None takes the rate of the first video, or else 25.
    segment, group : int
        Number of frames from one key frame to the next, and number of frames in a group. Depth is
        updated from the first frame of the group where nothing moved.

    Examples
    --------
    >>> from lfrender.sequence.options import FrameOptions
    >>> FrameOptions(preset="fast", suffix=".png").segment
    30
    """

    preset: Preset = "balanced"
    scale: float | None = None
    size: Size | None = None
    suffix: str = ".tif"
    views: ViewGrid | None = None
    eight_bits: bool = False
    exposure: Exposure | None = None
    tone: Tone = "auto"
    white_balance: WhiteBalance = "auto"
    quality: int | None = None
    shown_as: str = ""
    depth_maps: AnyPath | None = None
    rate: float | None = None
    segment: int = 30
    group: int = 5
