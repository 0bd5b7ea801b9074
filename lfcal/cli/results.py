"""What each command of lfcal prints with `--json`."""

from __future__ import annotations

from dataclasses import dataclass

from ..runtime.command_line import Result
from ..runtime.types import Entries, Size

__all__ = [
    "AssessResult",
    "BoardResult",
    "CameraResult",
    "CompareResult",
    "ConvertResult",
    "FlattenResult",
    "MetricResult",
    "ShowResult",
]

_Point = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class _CameraFigures(Result):
    """What is in a camera file; positions are pixels of the flat.

    size
        Width and height of the flats [px].
    lattice
        Its shape: hexagonal, square, rectangular or oblique.
    rows
        Direction of the rows of lenses.
    rotation_degrees
        Clockwise on the screen.
    pitch
        Distance of neighbouring centres [px].
    radius
        Usable radius of the microimages [px].
    origin
        Centre of microimage (0, 0): x, y.
    basis
        Steps from a centre to the next ones [px].
    lenses
        Number of microimages on the flat.
    source
        What the camera was made from: white, scene, published or truth.
    lens_types
        Number of types, confidence, focus [s / D] and cell of an array of several types.
    lenses_used
        Number of microimages in the fit.
    residual_rms
        Distance of microimages from the lattice [px].
    confidence
        Probability that the lattice is right.
    proof
        The evidence for the lattice, in words.
    evidence
        The figures of the evidence.
    mosaic
        Colour filters of the top left 2 x 2 pixels, or none.
    defect_pixels
        Number of defective pixels.
    defect_lenses
        Number of unlit lenses.
    lens_blur
        Blur of the microlenses, as in the camera file.
    optics
        Focal length and distances [mm], with standard errors.
    """

    size: Size
    lattice: str
    rows: str
    rotation_degrees: float
    pitch: float
    radius: float
    origin: _Point
    basis: tuple[_Point, _Point]
    lenses: int
    source: str
    lens_types: Entries | None
    lenses_used: int | None
    residual_rms: float | None
    confidence: float | None
    proof: str | None
    evidence: Entries | None
    mosaic: str
    defect_pixels: int
    defect_lenses: int
    lens_blur: Entries | None
    optics: Entries | None


@dataclass(frozen=True, kw_only=True)
class CameraResult(_CameraFigures):
    """A camera file, and what is in it.

    camera
        The camera file.
    """

    camera: str


@dataclass(frozen=True, kw_only=True)
class ConvertResult(_CameraFigures):
    """The written file, and what is in the camera.

    written
        The file.
    """

    written: str


@dataclass(frozen=True, kw_only=True)
class ShowResult(_CameraFigures):
    """The written picture, and what is in the camera.

    picture
        The file.
    look_at
        Sentences about places where the camera may be wrong.
    """

    picture: str
    look_at: list[str]


@dataclass(frozen=True, kw_only=True)
class FlattenResult(Result):
    """The evenly lit flat.

    written
        The file.
    size
        Width and height [px].
    type
        Type of the pixels.
    """

    written: str
    size: Size
    type: str


@dataclass(frozen=True, kw_only=True)
class CompareResult(Result):
    """How the centres of two cameras differ, b minus a [px].

    a
        First camera file.
    b
        Second camera file.
    rms
        Of the distances of all centres.
    max
        The largest distance.
    mean_shift
        Mean difference: x, y.
    scale
        Pitch of b over pitch of a.
    rotation_degrees
        Of b against a, clockwise.
    field
        Mean difference in each of nine parts of the flat: x, y.
    """

    a: str
    b: str
    rms: float
    max: float
    mean_shift: _Point
    scale: float
    rotation_degrees: float
    field: dict[str, _Point]


@dataclass(frozen=True, kw_only=True)
class AssessResult(Result):
    """How the array is mounted.

    findings
        Value, standard error, unit, verdict, advice and details of each figure.
    confidence
        Probability that the lattice is right.
    """

    findings: dict[str, Entries]
    confidence: float


@dataclass(frozen=True, kw_only=True)
class BoardResult(Result):
    """The board to print.

    written
        The file.
    board
        Pattern and size, in words.
    square_mm
        Side of a square [mm].
    """

    written: str
    board: str
    square_mm: float


@dataclass(frozen=True, kw_only=True)
class MetricResult(Result):
    """The optics that were measured, each with its standard error as `..._error` if it was fitted.

    camera
        The camera file.
    optics
        Focal length and distances [mm], distortion and tilt.
    flats_used
        Number of flats with a board that fits.
    corners
        Number of corners.
    outliers
        Number of corners that were left out.
    rms_px
        Distance of the corners from the model [px].
    corner_noise_px
        Noise of the corners [px].
    variance_widened_by
        Factor on variances, for what the noise does not explain.
    cramer_rao_position_mm
        Cramer-Rao bound of the positions of the boards: x, y, z [mm].
    cramer_rao_turn_degrees
        Cramer-Rao bound of the rotations of the boards.
    distances_mm
        Distance of each board [mm].
    distance_errors_mm
        Standard error of each distance [mm].
    """

    camera: str
    optics: Entries
    flats_used: int
    corners: int
    outliers: int
    rms_px: float
    corner_noise_px: float
    variance_widened_by: float
    cramer_rao_position_mm: list[float]
    cramer_rao_turn_degrees: list[float]
    distances_mm: list[float]
    distance_errors_mm: list[float]
