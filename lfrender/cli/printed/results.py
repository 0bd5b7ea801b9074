"""What each command of lfrender prints with `--json`."""

from __future__ import annotations

from dataclasses import dataclass

from lfcal.runtime.command_line import Result

from ...runtime.types import Place, Size, Triple

__all__ = [
    "AnalyzeResult",
    "BatchResult",
    "DemoResult",
    "LensletResult",
    "PageResult",
    "RefocusResult",
    "RenderResult",
    "ReportResult",
    "ViewsResult",
    "VolumeResult",
    "WarmResult",
]

# Null where they are not known, or make no sense.
_Number = float | None
_Count = int | None
_Text = str | None
# Figures by the name of a mode, reason, shortcut or picture.
_Measures = dict[str, float]


@dataclass(frozen=True, kw_only=True)
class _CaptureFigures(Result):
    """Figures of the camera; null where no depth was analysed, those of the depth.

    pitch
        Distance of neighbouring microimages [px].
    lenses
        Number of microimages on the flat.
    camera_source
        What the camera was made from: white, scene, published or truth.
    camera_confidence
        Probability that the lattice is right.
    lenses_analysed
        Number of lenses whose depth was analysed.
    modes
        Shares of these lenses: telescopic, binocular, unresolved.
    patch_size_median
        Median of abs(s) [px].
    unresolved
        Shares of lenses without a depth, by reason.
    saved
        Shares of the work that shortcuts saved.
    distance_median
        Median distance in front of the main lens [m]; with optics.
    distance_range
        Distances [m] between which nine tenths of the lenses lie.
    distance_error
        Median of the standard errors of the distances [m].
    """

    pitch: float
    lenses: int
    camera_source: str
    camera_confidence: float
    lenses_analysed: _Count = None
    modes: _Measures | None = None
    patch_size_median: _Number = None
    unresolved: _Measures | None = None
    saved: _Measures | None = None
    distance_median: _Number = None
    distance_range: tuple[_Number, _Number] | None = None
    distance_error: _Number = None


@dataclass(frozen=True, kw_only=True)
class _PictureFigures(_CaptureFigures):
    """A picture and its place over the flat.

    picture
        The file.
    size
        Width and height [px].
    scale
        Output pixels per pitch.
    valid
        Share of pixels that a lens has seen.
    affine
        From pixel (u, v, 1) to scene coordinates [px of the flat].
    """

    picture: _Text = None
    size: Size
    scale: float
    valid: float
    affine: tuple[Triple, Triple]


@dataclass(frozen=True, kw_only=True)
class RenderResult(_PictureFigures):
    """The picture.

    tiles
        Number of tiles, if it was drawn in tiles.
    tiles_kept
        Number of tiles that an earlier run had drawn.
    """

    tiles: _Count = None
    tiles_kept: _Count = None


@dataclass(frozen=True, kw_only=True)
class RefocusResult(_PictureFigures):
    """The picture in focus at one depth, or a focal stack.

    pictures
        The files of a stack that has several; `picture` is null then.
    patch_sizes
        Patch size in focus [px] of each picture; empty where a place was given.
    """

    pictures: list[str] | None = None
    patch_sizes: list[float]


@dataclass(frozen=True, kw_only=True)
class AnalyzeResult(_CaptureFigures):
    """The depth.

    depth
        The file of `--output`.
    colours
        Magnifications at both ends of the colours of `--picture`.
    """

    depth: str
    colours: Place | None = None


@dataclass(frozen=True, kw_only=True)
class ViewsResult(_CaptureFigures):
    """Views of other places in the main lens.

    views
        The folder or file.
    offsets
        Viewpoint of each view [px of the microimages]: x, y.
    unit
        Of posed views: metres or pitches.
    camera_error
        Of posed views: error of the camera model [px].
    positions
        Of posed views: position of each camera.
    """

    views: str
    offsets: list[Place]
    unit: _Text = None
    camera_error: _Number = None
    positions: list[Triple] | None = None


@dataclass(frozen=True, kw_only=True)
class VolumeResult(_CaptureFigures):
    """Volumes; all figures are those of the last one.

    volume
        The first file.
    volumes
        All files.
    frames
        Number of volumes: those of a time lapse are in one file.
    shape
        Voxels along z, y and x.
    spacing
        Distance of voxels along z, y and x, in the unit.
    unit
        um or px.
    residual
        Part of the flat that the volume does not explain.
    noise
        Noise of the flat, in the same measure.
    steps
        Steps of the deconvolution.
    stopped
        Why it stopped.
    """

    volume: str
    volumes: list[str]
    frames: int
    shape: list[int]
    spacing: list[float]
    unit: str
    residual: float
    noise: float
    steps: int
    stopped: str


@dataclass(frozen=True, kw_only=True)
class BatchResult(Result):
    """A run over the frames of a sequence; exit code 1 if frames failed.

    film
        The film, if it is one.
    pictures
        The folder, if it is no film.
    rendered
        Number of frames that were rendered.
    kept
        Number of frames that an earlier run had rendered.
    failed
        Number of frames that failed; `warnings` say why.
    seconds_per_frame
        Seconds of each rendered frame.
    still
        Share of lenses that had not moved.
    depth_maps
        The folder or film of `--depth-maps`.
    colours
        Magnifications at both ends of the colours of a film of depth.
    """

    film: _Text = None
    pictures: _Text = None
    rendered: int
    kept: int
    failed: int
    seconds_per_frame: float
    still: float
    depth_maps: _Text = None
    colours: Place | None = None


@dataclass(frozen=True, kw_only=True)
class ReportResult(_CaptureFigures):
    """The page about a flat.

    report
        The file.
    """

    report: str


@dataclass(frozen=True, kw_only=True)
class PageResult(Result):
    """The page.

    page
        Its address, or its file.
    """

    page: str


@dataclass(frozen=True, kw_only=True)
class DemoResult(Result):
    """The simulated capture against its truth; `one_depth` are lenses that see one depth.

    page
        The file.
    flat_size
        Width and height of the flat [px].
    pitch
        True distance of neighbouring microimages [px].
    lenses
        Number of microimages.
    lenses_judged
        Number of lenses whose truth has a mode.
    calibration
        Error of the centres [px, RMS] and confidence, from the scene and from the white image.
    mode_right
        Share of lenses with the true mode.
    mode_wrong
        Share of lenses with the other mode.
    magnification_error
        Median relative error of the magnification.
    merit
        PSNR [dB] and SSIM of each picture against the truth.
    fixed_patch_size
        Patch size [px] of the pictures of one patch size.
    picture_size
        Width and height of the sharp picture [px].
    scale
        Its pixels per pitch.
    """

    page: str
    flat_size: Size
    pitch: float
    lenses: int
    lenses_judged: int
    calibration: dict[str, _Measures]
    mode_right: _Measures
    mode_wrong: _Measures
    magnification_error: _Measures
    merit: dict[str, _Measures]
    fixed_patch_size: _Measures
    picture_size: Size
    scale: float


@dataclass(frozen=True, kw_only=True)
class LensletResult(Result):
    """The flat of a grid of views, or the views of a flat.

    flat
        The file of the flat.
    camera
        Its camera file.
    views
        The folder of the views.
    grid
        Rows and columns of the views.
    size
        Width and height of the flat or of each view [px].
    """

    flat: _Text = None
    camera: _Text = None
    views: _Text = None
    grid: Size
    size: Size


@dataclass(frozen=True, kw_only=True)
class WarmResult(Result):
    """Compiled kernels.

    compiled
        Whether kernels had to be compiled.
    kernels_failed
        Number of kernels that could not be compiled.
    compile_seconds
        Seconds of compiling.
    """

    compiled: bool
    kernels_failed: int
    compile_seconds: float
