"""The table of all options, and the commands that take them.

What a command works on is the same everywhere, a `CaptureInput`: its options make sense for every
command, or are refused with the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from typing import Any, get_args

import click
import cloup

from lfcal import LightFieldError
from lfcal.runtime import command_line as cl
from lfcal.runtime.image_formats import MOSAICS

from ..runtime.choices import Detail, PoseFormat, Preset
from .inputs import CaptureInput

__all__ = [
    "at_most_one",
    "capture_command",
    "connect_cluster",
    "declare",
    "option_errors",
    "output_option",
]

_FILE = cl.InputPath()
_OUTPUT = cl.OutputPath()
_SIZE = cl.Pair("WxH", "2048x1536")
_GRID = cl.Pair("ROWSxCOLUMNS", "5x5")
_PRESET = click.Choice(get_args(Preset))
_POSES = click.Choice(get_args(PoseFormat))
_POSITIVE = click.FloatRange(0, min_open=True)
_SHARE = click.FloatRange(0, 1, min_open=True)


def _row(*names_kind_help: Any, **more: Any) -> tuple[tuple[Any, ...], dict[str, Any]]:
    return names_kind_help, more


#: Names, type, help and further arguments of `command_line.option`, by the name of the value.
TABLE = {
    # Of the capture.
    "camera": _row(
        "-c --camera",
        _FILE,
        "Camera file of lfcal, or a published calibration (.xml, .cfg). Without it, FLAT itself "
        "is calibrated.",
    ),
    "white": _row("--white", _FILE, "Calibrate from this white image of the same camera."),
    "depth_file": _row("--depth depth_file", _FILE, "Depth map made by 'lfrender analyze'."),
    "dark": _row(
        "--dark", _FILE, "Dark frame that is subtracted from FLAT and from the white image."
    ),
    "preset": _row(
        "--preset", _PRESET, "How much time the depth analysis may take. [default: balanced]"
    ),
    "roi": _row(
        "--roi",
        float,
        "Only the part between two opposite corners [px of the flat].",
        nargs=4,
        metavar="X0 Y0 X1 Y1",
    ),
    "mosaic": _row(
        "--mosaic",
        click.Choice(MOSAICS, case_sensitive=False),
        "Colour filters of the top left 2 x 2 pixels of a raw mosaic, if the camera file does "
        "not have them.",
    ),
    "page": _row(
        "--page",
        click.IntRange(0),
        "Which picture of a TIFF of several, or frame of a video, from 0.",
        metavar="N",
    ),
    "size": _row("--size", _SIZE, "Of raw video (.yuv), if its name does not have it."),
    "pixel_format": _row(
        "--pixel-format", str, "Of raw video: yuv420p10, yuv444p, ...", metavar="FORMAT"
    ),
    # What to draw.
    "patch_size": _row(
        "--patch-size",
        float,
        "One signed patch size [px] for all lenses: > 0 telescopic, < 0 binocular.",
    ),
    "blend": _row(
        "--blend", bool, "With --patch-size: the mean over lenses instead of the nearest one."
    ),
    "traditional": _row(
        "--traditional", bool, "One pixel per microlens, the mean of its microimage."
    ),
    "scale": _row("--scale", _POSITIVE, "Output pixels per microlens pitch."),
    "edges": _row(
        "--edges/--no-edges",
        None,
        "Place depth edges on the pixels of the microimages: cleaner outlines, in up to twice "
        "the time. The "
        "preset 'balanced' does so.",
        default=None,
    ),
    "detail": _row(
        "--detail",
        click.Choice(get_args(Detail)),
        "Undo the blur of the microlenses, place by place, as noise allows. [default: natural, "
        "for depth maps]",
    ),
    "at": _row("--at", float, "Focus on this place [px of the flat].", nargs=2, metavar="X Y"),
    "patch_sizes": _row(
        "--patch-size patch_sizes",
        float,
        "Signed patch size [px] in focus: > 0 telescopic, < 0 binocular. Several: a focal stack.",
        multiple=True,
    ),
    "stack": _row(
        "--stack",
        click.IntRange(1),
        "N pictures from the farthest depth to the nearest.",
        metavar="N",
    ),
    "focus_aperture": _row(
        "--aperture aperture",
        float,
        "Part of the aperture used, 0.05 to 1.",
        default=1.0,
        show_default=True,
    ),
    "exhaustive": _row("--exhaustive", bool, "Take no shortcuts: match every lens at every shift."),
    # Views.
    "grid": _row(
        "--grid", _GRID, "Pictures on a grid of viewpoints, row1_column1 ... [default: 5x5]"
    ),
    "stereo": _row(
        "--stereo", bool, "The view of the left eye, and beside it that of the right one."
    ),
    "animation": _row(
        "--animation",
        click.IntRange(2),
        "N views around a circle; 24 where the output is .gif, .mp4, .mov or .mkv.",
        metavar="N",
    ),
    "quilt": _row(
        "--quilt",
        cl.Pair("COLUMNSxROWS", "8x6"),
        "Views from left to right in one picture, for holographic displays: 8x6.",
    ),
    "poses": _row(
        "--poses",
        _POSES,
        "The grid with cameras, depth and masks for this program; metric with known optics.",
    ),
    "view_aperture": _row(
        "--aperture aperture",
        _SHARE,
        "How far from the middle, as a part of the radius of the microimages: more parallax, "
        "less light.",
        default=0.7,
        show_default=True,
    ),
    "resize": _row("--resize", _SIZE, "Size of the views [px]."),
    "grid_format": _row(
        "--format suffix",
        str,
        "Of the grid's pictures: tif, png, yuv, ...",
        default="tif",
        show_default=True,
    ),
    "frame_views": _row(
        "--views",
        _GRID,
        "Views of a grid: with --format yuv a file for each, v000-WxH.yuv ..., else "
        "FRAME/image_001 ...",
    ),
    "frame_aperture": _row(
        "--aperture aperture", _SHARE, "Of --views, as in 'lfrender views'. [default: 0.7]"
    ),
    # How to write it.
    "eight_bits": _row(
        "--8bit eight_bits",
        bool,
        "Write 8 bits a channel, in proportion: 0 to white become 0 to 255. JPEG and WebP do so "
        "by themselves.",
    ),
    "exposure": _row(
        "--exposure",
        cl.ExposureValue(),
        "Brighten by so many EV, or dim pictures by their content. [default: auto for JPEG, "
        "WebP, GIF and MP4]",
    ),
    "alpha": _row("--alpha", bool, "Make pixels that no lens has seen transparent (not in JPEG)."),
    "compress": _row("--compress", bool, "Write a TIFF in deflated tiles: smaller and slower."),
    "tile": _row(
        "--tile",
        click.IntRange(16),
        "Draw in tiles of this side, with little memory; an interrupted run is continued. "
        "[default: large "
        "flats]",
        metavar="PIXELS",
    ),
    "frame_format": _row(
        "--format suffix",
        str,
        "Format of the pictures: tif, jpg, ...; of views also yuv. [default: tif]",
    ),
    "frames": _row(
        "--frames",
        str,
        "Only these of all frames, counted from 0, as Python slices do: 10:60:2, 10:, ::2, or 7.",
        metavar="START:STOP:STEP",
    ),
    "start": _row(
        "--start",
        click.FloatRange(0),
        "Only frames from this time of a video on.",
        metavar="SECONDS",
    ),
    "end": _row(
        "--end",
        click.FloatRange(0, min_open=True),
        "Only frames before this time of a video.",
        metavar="SECONDS",
    ),
    "depth_maps": _row(
        "--depth-maps",
        cl.OutputPath(),
        "Also the depth of every frame: FRAME.npz in a folder, or a film of magnifications in "
        "colours.",
        metavar="FOLDER|FILM",
    ),
    "fps": _row(
        "--fps",
        click.FloatRange(0, 1000, min_open=True),
        "Pictures a second of a film. [default: those taken of the input, or 25]",
    ),
    "overwrite": _row(
        "--overwrite", bool, "Render all frames again; else pictures already there are kept."
    ),
    "dense": _row(
        "--dense",
        _OUTPUT,
        "Patch size [px] of every pixel of the picture, its validity and standard error (pages, "
        "or channels).",
        metavar="DEPTH.tif|.pfm|.exr",
    ),
    "unfilled": _row(
        "--unfilled",
        bool,
        "Write NaN to --dense where no lens has a depth, not that of places around.",
    ),
    "picture": _row("--picture", _OUTPUT, "Magnification M in colours.", metavar="DEPTH.png"),
    "ply": _row(
        "--ply",
        _OUTPUT,
        "Point cloud: X/D, Y/D, virtual depth D/s, colour.",
        metavar="CLOUD.ply|.pcd",
    ),
    "mesh": _row(
        "--mesh",
        _OUTPUT,
        "The scene as textured triangles (needs trimesh).",
        metavar="MESH.glb|.ply",
    ),
    "optics": _row(
        "--optics",
        _FILE,
        "Focal length and distances [mm] of the camera: distances in metres, the point cloud and "
        "--poses too. "
        "By default those of the camera file, if 'lfcal metric' has measured them.",
        metavar="OPTICS.json",
    ),
    "metres": _row("--metres", bool, "Write --dense as distances in front of the main lens [m]."),
    # Of volumes.
    "na": _row("--na", _POSITIVE, "Numerical aperture of the objective."),
    "magnification": _row("--magnification", _POSITIVE, "From the specimen to the microlenses."),
    "medium_index": _row(
        "--medium-index",
        _POSITIVE,
        "Refractive index about the specimen.",
        default=1.33,
        show_default=True,
    ),
    "microlens_focal_length": _row(
        "--microlens-focal-length", _POSITIVE, "Of the microlenses.", metavar="UM"
    ),
    "pixel_size": _row(
        "--pixel-size",
        _POSITIVE,
        "Side of a pixel, as the microlenses see it through relay lenses.",
        metavar="UM",
    ),
    "wavelength": _row("--wavelength", _POSITIVE, "For the blur of diffraction.", metavar="NM"),
    "depth_range": _row(
        "--depth-range",
        float,
        "First and last plane, from the native plane towards the objective [um], or without "
        "optics as slopes "
        "k = -D / s. [default: as far as a pixel averages over a pitch]",
        nargs=2,
        metavar="FIRST LAST",
    ),
    "planes": _row(
        "--planes", click.IntRange(2), "Number of planes.", default=41, show_default=True
    ),
    "steps": _row(
        "--steps",
        click.IntRange(1),
        "Of the deconvolution, at most.",
        default=40,
        show_default=True,
    ),
    "voxels": _row(
        "--voxels",
        click.IntRange(2),
        "Along each side of a microlens.",
        default=8,
        show_default=True,
    ),
    # Where to show it.
    "export": _row(
        "--export",
        _OUTPUT,
        "Write the page instead: as one file that holds everything, or as a folder of static "
        "files for web "
        "pages.",
        metavar="FOLDER|PAGE.html",
    ),
    "port": _row(
        "--port",
        click.IntRange(0, 65535),
        "Port on this machine; by default a free one.",
        default=0,
    ),
    "no_browser": _row(
        "--no-browser", bool, "Only print the address of the page, do not open a browser."
    ),
    "host": _row(
        "--host",
        str,
        "Serve the page on this address, for other machines too; the page then needs a token.",
        metavar="ADDRESS",
        default="127.0.0.1",
        show_default=True,
    ),
    # Of live frames.
    "live_folder": _row(
        "-o --output",
        _OUTPUT,
        "Folder for recordings and snapshots.",
        metavar="FOLDER",
        default=".",
        show_default=True,
    ),
    "live_format": _row(
        "--pixel-format",
        str,
        "What a GenICam camera is set to: Mono8, Mono12, BayerRG8, ... [default: as it is]",
        metavar="FORMAT",
    ),
    "live_rate": _row(
        "--fps",
        click.FloatRange(0, 1000, min_open=True),
        "Frames a second of files. [default: of the video, or 10]",
    ),
    "live_exposure": _row(
        "--exposure",
        cl.ExposureValue(),
        "Show frames brighter by so many EV. [default: auto: dim ones by their content, until "
        "the next calibration]",
    ),
    "live_preset": _row(
        "--preset", _PRESET, "How much time the depth analysis may take. [default: fast]"
    ),
    # Several processes.
    "workers": _row(
        "--workers", click.IntRange(1), "Work in so many processes of this machine (needs Dask)."
    ),
    "scheduler": _row(
        "--scheduler", str, "Work on this Dask scheduler.", metavar="tcp://HOST:PORT"
    ),
    "processes": _row(
        "--processes",
        click.IntRange(1),
        "Processes that compile. [default: all cores]",
        metavar="N",
    ),
}
#: Options of all commands on captures, by their titles in the help.
_CAPTURE = {
    "Files": ("camera", "white", "depth_file", "dark"),
    "Depth analysis": ("preset",),
    "Reading FLAT": ("roi", "mosaic", "page", "size", "pixel_format"),
}
_FIELDS = [name for names in _CAPTURE.values() for name in names]


def declare(name: str, inputs: str = "FLAT", **further: Any) -> Callable[[Any], Any]:
    """An option of the table; `inputs` is what the camera is calibrated from, in the help."""
    (names, kind, text), more = TABLE[name]
    return cl.option(names, kind, text.replace("FLAT", inputs), **more, **further)


def output_option(metavar: str, text: str, piped: str = "", **more: Any) -> Callable[[Any], Any]:
    """The option `--output`; `piped` is the format on stdout with `-`, empty if refused."""
    text += f" With -, {piped[1:].upper()} to stdout." if piped else ""
    return cl.option(
        "-o --output", cl.OutputPath(piped), text, metavar, **{"required": True, **more}
    )


def capture_command(
    *examples: str,
    output: tuple[str, ...] = (),
    own: Mapping[str, str] | None = None,
    refused: Mapping[str, str] | None = None,
    inputs: str = "FLAT",
    several: str = "",
) -> Callable[[Any], click.Command]:
    """Make a command on captures; it is called with a `CaptureInput` and its own options.

    These are `output`, as for `output_option`, and `own`: titles in the help, with names of options
    in the table. `refused` are options of captures that make no sense, with the reason to say. A
    command that takes `several` inputs calls them so, and its camera is calibrated from the first
    of the `inputs`. `examples` are shown in the help.
    """
    reasons = refused or {}

    def decorate(function: Any) -> click.Command:
        @wraps(function)
        def run(report: cl.Report, given: Any) -> Any:
            values = vars(given)
            fields = {name: values.pop(name) for name in _FIELDS}
            for name, reason in reasons.items():
                if fields[name] is not None:
                    option = next(
                        word for word in TABLE[name][0][0].split() if word.startswith("--")
                    )
                    raise click.UsageError(f"{option} makes no sense here: {reason}")
            at_most_one("--camera", fields["camera"], "--white", fields["white"])
            flat = given.inputs[0] if several else values.pop("flat")
            return function(CaptureInput(report, flat, **fields), given)

        decorated: Any = cl.report_options(run)
        decorated = cl.with_options(*(declare(name, hidden=True) for name in reasons))(decorated)
        shown: dict[str, list[Callable[[Any], Any]]] = {
            "Files": [output_option(*output)] if output else []
        }
        for title, names in (own or {}).items():
            shown.setdefault(title, []).extend(map(declare, names.split()))
        for title, fields in _CAPTURE.items():
            shown.setdefault(title, []).extend(
                declare(name, inputs) for name in fields if name not in reasons
            )
        # Click shows the option of the outermost decorator first.
        for title, some in reversed(shown.items()):
            decorated = (
                cloup.option_group(title.replace("FLAT", inputs), *some)(decorated)
                if some
                else decorated
            )
        argument = (
            cl.several_inputs("inputs", several) if several else click.argument("flat", type=_FILE)
        )
        return cl.command(*examples)(argument(decorated))

    return decorate


@contextmanager
def connect_cluster(given: Any, report: cl.Report) -> Iterator[dict[str, Any]]:
    """The arguments for work on the processes or the scheduler that `given` names."""
    at_most_one("--workers", given.workers, "--scheduler", given.scheduler)
    if not (given.workers or given.scheduler):
        yield {}
        return
    from ..sequence.workers import connect

    # Or each worker on this machine would.
    report.compile_kernels()
    with connect(given.workers, given.scheduler) as client:
        yield {"client": client, "threads": 1 if given.workers else None}


def at_most_one(*pairs: Any) -> None:
    """Raise an error if several options are given; names and values are passed in turn."""
    values = zip(pairs[::2], pairs[1::2], strict=True)
    given = [name for name, value in values if value is not None and value is not False]
    if len(given) > 1:
        raise click.UsageError(f"{given[0]} and {given[1]} exclude each other")


@contextmanager
def option_errors() -> Iterator[None]:
    """Report a ValueError as an error of usage of the option the argument comes from."""
    try:
        yield
    except LightFieldError:
        raise
    except ValueError as error:
        argument, space, rest = str(error).partition(" ")
        names = {"patch_size": "--patch-size", "position": "--at"}
        names |= {
            name: f"--{name}" for name in ("aperture", "roi", "scale", "frames", "start", "na")
        }
        names["depth_range"] = "--depth-range"
        raise click.UsageError(f"{names.get(argument, argument)}{space}{rest}") from error
