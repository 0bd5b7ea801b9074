"""The table of all options, how commands take them from it, and how errors in their values are reported.

What a command works on is the same everywhere, a `CaptureInput`: its options make sense for every command, or are
refused with the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click

from lfcal import LightFieldError
from lfcal.runtime import console
from lfcal.runtime.image_formats import MOSAICS

from .inputs import CaptureInput

__all__ = [
    "at_most_one", "capture_command", "connect_cluster", "grid_size", "option_errors", "options", "output_option",
]  # fmt: skip


class _Corner(click.ParamType):
    """A coordinate of a corner."""

    name = "px"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        try:
            return float(value)
        except ValueError:
            self.fail(f"give four numbers, X0 Y0 X1 Y1 [px of the flat]; {value!r} is none", param, ctx)


_FILE, _OUTPUT, _SIZE = console.InputPath(), console.OutputPath(), console.SizeOption()
_PRESET, _POSES = click.Choice(["fast", "balanced", "accurate"]), click.Choice(["nerfstudio", "colmap", "rvs"])
_POSITIVE, _SHARE = click.FloatRange(0, min_open=True), click.FloatRange(0, 1, min_open=True)


def _option(names: str, kind: Any, text: str, **more: Any) -> tuple[tuple[str, ...], dict[str, Any]]:
    return tuple(names.split()), {"help": text, **({"is_flag": True} if kind is bool else {"type": kind}), **more}


# fmt: off
#: Names and further arguments of `click.option`, by the name of the value.
TABLE = {
    # Of the capture.
    "camera": _option("-c --camera", _FILE,
        "Camera file of lfcal, or a published calibration (.xml, .cfg). Without it, FLAT itself is "
        "calibrated."),
    "white": _option("--white", _FILE, "Calibrate from this white image of the same camera."),
    "depth_file": _option("--depth depth_file", _FILE, "Depth map made by 'lfrender analyze'."),
    "dark": _option("--dark", _FILE, "Dark frame that is subtracted from FLAT and from the white image."),
    "preset": _option("--preset", _PRESET, "How much time the depth analysis may take. [default: balanced]"),
    "roi": _option("--roi", _Corner(),
        "Only the part between two opposite corners [px of the flat].", nargs=4, metavar="X0 Y0 X1 Y1"),
    "mosaic": _option("--mosaic", click.Choice(MOSAICS, case_sensitive=False),
        "Colour filters of the top left 2 x 2 pixels of a raw mosaic, if the camera file does not have them."),
    "page": _option("--page", click.IntRange(0),
        "Which picture of a TIFF of several, or frame of a video, from 0.", metavar="N"),
    "size": _option("--size", _SIZE, "Of raw video (.yuv), if its name does not have it."),
    "pixel_format": _option("--pixel-format", str, "Of raw video: yuv420p10, yuv444p, ...", metavar="FORMAT"),
    # What to draw.
    "patch_size": _option("--patch-size", float,
        "One signed patch size [px] for all lenses: > 0 telescopic, < 0 binocular."),
    "blend": _option("--blend", bool, "With --patch-size: the mean over lenses instead of the nearest one."),
    "traditional": _option("--traditional", bool, "One pixel per microlens, the mean of its microimage."),
    "scale": _option("--scale", _POSITIVE, "Output pixels per microlens pitch."),
    "edges": _option("--edges/--no-edges", None,
        "Place depth edges on the pixels of the microimages: cleaner outlines, in up to twice the time. The "
        "preset 'balanced' does so.", default=None),
    "detail": _option("--detail", click.Choice(["natural", "off"]),
        "Undo the blur of the microlenses, place by place, as noise allows. [default: natural, for depth maps]"),
    "sharpen": _option("--sharpen", str, "Gone.", hidden=True),
    "at": _option("--at", float, "Focus on this place [px of the flat].", nargs=2, metavar="X Y"),
    "patch_sizes": _option("--patch-size patch_sizes", float,
        "Signed patch size [px] in focus: > 0 telescopic, < 0 binocular. Several times: a focal stack.", multiple=True),
    "stack": _option("--stack", click.IntRange(1), "N pictures from the farthest depth to the nearest.", metavar="N"),
    "focus_aperture": _option("--aperture aperture", float,
        "Part of the aperture used, 0.05 to 1.", default=1.0, show_default=True),
    "exhaustive": _option("--exhaustive", bool, "Take no shortcuts: match every lens at every shift."),
    # Views.
    "grid": _option("--grid", str,
        "Pictures on a grid of viewpoints, row1_column1 ... [default: 5x5]", metavar="ROWSxCOLUMNS"),
    "stereo": _option("--stereo", bool, "The view of the left eye, and beside it that of the right one."),
    "animation": _option("--animation", click.IntRange(2),
        "N views around a circle; 24 where the output is .gif, .mp4 or .mkv.", metavar="N"),
    "quilt": _option("--quilt", str,
        "Views from left to right in one picture, for holographic displays: 8x6.", metavar="COLUMNSxROWS"),
    "poses": _option("--poses", _POSES,
        "The grid with cameras, depth and masks for this program; metric where the optics are known."),
    "view_aperture": _option("--aperture aperture", _SHARE,
        "How far from the middle, as a part of the radius of the microimages: more parallax, less light.",
        default=0.7, show_default=True),
    "resize": _option("--resize", _SIZE, "Size of the views [px]."),
    "grid_format": _option("--format suffix", str,
        "Of the grid's pictures: tif, png, yuv, ...", default="tif", show_default=True),
    "frame_views": _option("--views", str,
        "Views of a grid: with --format yuv a file for each, v000-WxH.yuv ..., else FRAME/image_001 ...",
        metavar="ROWSxCOLUMNS"),
    "frame_aperture": _option("--aperture aperture", _SHARE, "Of --views, as in 'lfrender views'. [default: 0.7]"),
    # How to write it.
    "eight_bits": _option("--8bit eight_bits", bool,
        "Write 8 bits a channel, in proportion: 0 to white become 0 to 255. JPEG and WebP do so by "
        "themselves."),
    "alpha": _option("--alpha", bool, "Make pixels that no lens has seen transparent (not in JPEG)."),
    "compress": _option("--compress", bool, "Write a TIFF in deflated tiles: smaller and slower."),
    "tile": _option("--tile", click.IntRange(16),
        "Draw in tiles of this side, with little memory; an interrupted run is continued. [default: large "
        "flats]", metavar="PIXELS"),
    "frame_format": _option("--format suffix", str,
        "Format of the pictures: tif, jpg, ...; of views also yuv. [default: tif]"),
    "fps": _option("--fps", click.FloatRange(0, 1000, min_open=True),
        "Pictures a second of a film. [default: as the input, or 25]"),
    "overwrite": _option("--overwrite", bool, "Render all frames again; else pictures already there are kept."),
    "dense": _option("--dense", _OUTPUT,
        "Patch size [px] of every pixel of the picture, and where a lens has one (second page, or channel).",
        metavar="DEPTH.tif|.pfm|.exr"),
    "unfilled": _option("--unfilled", bool,
        "Write NaN to --dense where no lens has a depth, not that of places around."),
    "picture": _option("--picture", _OUTPUT, "Magnification M in colours.", metavar="DEPTH.png"),
    "ply": _option("--ply", _OUTPUT, "Point cloud: X/D, Y/D, virtual depth D/s, colour.", metavar="CLOUD.ply|.pcd"),
    "optics": _option("--optics", _FILE,
        "Focal length and distances [mm] of the camera: distances in metres, the point cloud and --poses too. "
        "By default those of the camera file, if 'lfcal metric' has measured them.", metavar="OPTICS.json"),
    "metres": _option("--metres", bool, "Write --dense as distances in front of the main lens [m]."),
    # Where to show it.
    "export": _option("--export", _OUTPUT,
        "Write the page instead: as one file that holds everything, or as a folder of static files for web "
        "pages.", metavar="FOLDER|PAGE.html"),
    "port": _option("--port", click.IntRange(0, 65535), "Port on this machine; by default a free one.", default=0),
    "no_browser": _option("--no-browser", bool, "Only print the address of the page, do not open a browser."),
    # Several processes.
    "workers": _option("--workers", click.IntRange(1), "Work in so many processes of this machine (needs Dask)."),
    "scheduler": _option("--scheduler", str, "Work on this Dask scheduler.", metavar="tcp://HOST:PORT"),
    "processes": _option("--processes", click.IntRange(1), "Processes that compile. [default: all cores]", metavar="N"),
}
# fmt: on
#: Options of all commands on captures, by their titles in the help.
_CAPTURE = {
    "Files": ("camera", "white", "depth_file", "dark"),
    "Depth analysis": ("preset",),
    "Reading FLAT": ("roi", "mosaic", "page", "size", "pixel_format"),
}
_FIELDS = [name for names in _CAPTURE.values() for name in names]


def _declare(name: str, inputs: str = "FLAT", **further: Any) -> Callable[[Any], Any]:
    names, more = TABLE[name]
    return click.option(*names, **{**more, "help": more["help"].replace("FLAT", inputs), **further})


def output_option(metavar: str, text: str, piped: str = "", **more: Any) -> Callable[[Any], Any]:
    """The option `--output`; `piped` is the format of what goes to stdout with `-`, if that is possible."""
    text += f" With -, {piped[1:].upper()} to stdout." if piped else ""
    more = {"required": True, "metavar": metavar, **more}
    return click.option("-o", "--output", type=console.OutputPath(piped), help=text, **more)


def options(
    output: Callable[[Any], Any] | None = None,
    own: Mapping[str, str] | None = None,
    refused: Mapping[str, str] | str = "",
    inputs: str = "FLAT",
) -> Callable[[Any], Any]:
    """Give a command options of the table, and those of reports.

    It is called with a `CaptureInput`, and a namespace of the values of its own options: of `output`, as from
    `output_option`, and of `own`, titles in the help with the names of options under each. `refused` are options of the
    capture that make no sense, with the reason to say, or one reason for all of them. `inputs` is what the camera is
    calibrated from, in the help.
    """
    reasons = dict(refused) if not isinstance(refused, str) else dict.fromkeys(_FIELDS, refused) if refused else {}

    def decorate(function: Any) -> Any:
        @wraps(function)
        def run(as_json: bool, quiet: bool, **values: Any) -> Any:
            given = {name: values.pop(name) for name in _FIELDS}
            for name, reason in reasons.items():
                if given[name] is not None:
                    option = next(text for text in TABLE[name][0] if text.startswith("--"))
                    raise click.UsageError(f"{option} makes no sense here: {reason}")
            at_most_one("--camera", given["camera"], "--white", given["white"])
            flat = values["inputs"][0] if "inputs" in values else values.pop("flat", Path())
            capture = CaptureInput(console.Report(as_json, quiet), flat, **given)
            return function(capture, SimpleNamespace(**values))

        # Click shows the option of the outermost decorator first.
        decorated: Any = console.report_options(run)
        for name in reasons:
            decorated = _declare(name, hidden=True)(decorated)
        shown: dict[str, list[Callable[[Any], Any]]] = {"Files": [output] if output else []}
        for title, names in (own or {}).items():
            shown.setdefault(title, []).extend(_declare(name) for name in names.split())
        for title, fields in _CAPTURE.items():
            shown.setdefault(title, []).extend(_declare(name, inputs) for name in fields if name not in reasons)
        for title, some in reversed(shown.items()):
            decorated = console.grouped(title.replace("FLAT", inputs), *some)(decorated) if some else decorated
        return decorated

    return decorate


def capture_command(
    *examples: str, output: tuple[str, ...] | None = None, **more: Any
) -> Callable[[Any], click.Command]:
    """Make a command that works on one capture; `output` is for `output_option`, the rest as for `options`.

    `examples` are calls to show in the help.
    """
    hints = (
        "'lfrender batch' renders several",
        ("render all flats in it with 'lfrender batch {} -o pictures', or give one of them"),
    )

    def decorate(function: Any) -> click.Command:
        taken = options(None if output is None else output_option(*output), **more)(function)
        return console.command(*examples)(console.single_input("FLAT", *hints)(taken))

    return decorate


@contextmanager
def connect_cluster(workers: int | None, scheduler: str | None, report: console.Report) -> Iterator[dict[str, Any]]:
    """The arguments `client` and `threads` of functions that work on a cluster, none without one."""
    if workers is None and scheduler is None:
        yield {}
        return
    from ..sequence.workers import connect

    # Or each worker on this machine would.
    report.compile_kernels()
    with connect(workers, scheduler) as client:
        yield {"client": client, "threads": 1 if workers else None}


def at_most_one(*pairs: Any) -> None:
    """Raise an error if options exclude each other: names and values in turn, None or False for those not given."""
    values = zip(pairs[::2], pairs[1::2], strict=True)
    given = [name for name, value in values if value is not None and value is not False]
    if len(given) > 1:
        raise click.UsageError(f"{given[0]} and {given[1]} exclude each other")


def grid_size(option: str, text: str) -> tuple[int, int]:
    """Rows and columns of a grid such as `5x5`."""
    rows, cross, columns = text.lower().partition("x")
    if not (cross and rows.isdecimal() and columns.isdecimal() and int(rows) and int(columns)):
        raise click.UsageError(f"{option} must be ROWSxCOLUMNS such as 5x5, got {text!r}")
    return int(rows), int(columns)


@contextmanager
def option_errors(*values: Any) -> Iterator[None]:
    """Report a ValueError as an error of usage, if any of these values of options was given."""
    try:
        yield
    except LightFieldError:
        raise
    except ValueError as error:
        if all(value is None for value in values):
            raise
        # A message about an argument of a function is one about the option that it comes from.
        argument, space, rest = str(error).partition(" ")
        names = {"patch_size": "--patch-size", "position": "--at", "roi": "--roi", "scale": "--scale"}
        names["aperture"] = "--aperture"
        raise click.UsageError(f"{names.get(argument, argument)}{space}{rest}") from error
