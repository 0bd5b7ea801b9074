"""Options that several commands share, and how errors in their values are reported."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any

import click

from lfcal import LightFieldError
from lfcal.runtime import console
from lfcal.runtime.image_formats import MOSAICS

from .inputs import CaptureInput

__all__ = [
    "CAMERA", "INPUT", "OUTPUT", "at_most_one", "capture_command", "cluster_options", "connect_cluster",
    "edges_option", "eight_bits_option", "grid_size", "option_errors", "output_option", "preset_option", "roi_option",
    "scale_option", "white_option",
]  # fmt: skip

INPUT, OUTPUT = console.InputPath(), console.OutputPath()
CAMERA = "Camera file of lfcal, or a published calibration (.xml, .cfg)."

preset_option = click.option(
    "--preset",
    type=click.Choice(["fast", "balanced", "accurate"]),
    default="balanced",
    show_default=True,
    help="How much time the depth analysis may take.",
)
edges_option = click.option(
    "--edges/--no-edges",
    default=None,
    help="Place depth edges on the pixels of the microimages: cleaner outlines, in up to twice the time. The preset "
    "'balanced' does so.",
)
scale_option = click.option(
    "--scale", type=click.FloatRange(0, min_open=True), help="Output pixels per microlens pitch."
)
eight_bits_option = click.option(
    "--8bit",
    "eight_bits",
    is_flag=True,
    help="Write 8 bits a channel, in proportion: 0 to white become 0 to 255. JPEG and WebP do so by themselves.",
)
white_option = click.option("--white", type=INPUT, help="Calibrate from this white image of the same camera.")
_camera_option = click.option("-c", "--camera", type=INPUT, help=f"{CAMERA} Without it, FLAT itself is calibrated.")
_depth_option = click.option("--depth", "depth_file", type=INPUT, help="Depth map made by 'lfrender analyze'.")
_mosaic_option = click.option(
    "--mosaic",
    type=click.Choice(MOSAICS),
    help="Colour filters of the top left 2 x 2 pixels of a raw mosaic, if the camera file does not have them.",
)
_dark_option = click.option("--dark", type=INPUT, help="Dark frame that is subtracted from FLAT and the white image.")


def output_option(metavar: str, text: str, piped: str = "") -> Callable[[Any], Any]:
    """The option `--output`; `piped` is the format of what goes to stdout with `-`, if that is possible."""
    kind = console.OutputPath(piped)
    text += f" With -, {piped[1:].upper()} to stdout." if piped else ""
    return click.option("-o", "--output", type=kind, required=True, metavar=metavar, help=text)


def roi_option(text: str) -> Callable[[Any], Any]:
    """The option `--roi`; `lfrender.data.region.check_region` checks it, for commands and functions alike."""
    return click.option("--roi", type=_Corner(), nargs=4, metavar="X0 Y0 X1 Y1", help=text)


class _Corner(click.ParamType):
    """A coordinate of a corner."""

    name = "px"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        try:
            return float(value)
        except ValueError:
            self.fail(f"give four numbers, X0 Y0 X1 Y1 [px of the flat]; {value!r} is none", param, ctx)


def capture_command(
    *examples: str,
    output: tuple[str, ...] | None = None,
    white: bool = False,
    depth: bool = True,
    mosaic: bool = False,
    preset: bool = True,
) -> Callable[[Any], click.Command]:
    """Make a command that works on one capture, with the options that such commands share.

    The function is called with `capture`, a `CaptureInput`, in place of these options, and with its own ones. `output`
    is what `output_option` takes; `examples` are calls to show in the help.
    """

    def decorate(function: Any) -> click.Command:
        @wraps(function)
        def run(as_json: bool, quiet: bool, **values: Any) -> Any:
            at_most_one("--camera", values["camera"], "--white", values.get("white"))
            given = {name: values.pop(name) for name in CaptureInput.OPTIONS if name in values}
            return function(capture=CaptureInput(console.Report(as_json, quiet), **given), **values)

        own = run.__dict__.pop("__click_params__", [])
        # Click shows the option of the outermost decorator first.
        decorated: Any = console.report_options(run)
        reading = [_mosaic_option] if mosaic else []
        reading += [console.page_option, console.raw_video_options]
        decorated = console.grouped("Reading FLAT", *reading)(decorated)
        decorated = console.grouped("Depth analysis", preset_option)(decorated) if preset else decorated
        decorated.__click_params__.extend(own)
        files = [
            (output is not None, output_option(*(output or ("", "")))),
            (True, _camera_option), (white, white_option), (depth, _depth_option), (True, _dark_option),
        ]  # fmt: skip
        decorated = console.grouped("Files", *(option for wanted, option in files if wanted))(decorated)
        flat = console.single_input(
            "FLAT",
            "'lfrender batch' renders several",
            "render all flats in it with 'lfrender batch {} -o pictures', or give one of them",
        )
        return console.command(*examples)(flat(decorated))

    return decorate


def cluster_options(command: Any) -> Any:
    """Give a command the options `--workers` and `--scheduler`."""
    scheduler = click.option("--scheduler", metavar="tcp://HOST:PORT", help="Work on this Dask scheduler.")
    workers = click.option(
        "--workers", type=click.IntRange(1), help="Work in so many processes of this machine (needs Dask)."
    )
    return console.grouped("Several processes", workers, scheduler)(command)


@contextmanager
def connect_cluster(workers: int | None, scheduler: str | None, report: console.Report) -> Iterator[dict[str, Any]]:
    """The arguments `client` and `threads` of functions that work on a cluster, none without one."""
    if workers is None and scheduler is None:
        yield {}
        return
    from ..sequence.cluster import connect

    # Or each worker on this machine would.
    report.compile_kernels()
    with connect(workers, scheduler) as client:
        yield {"client": client, "threads": 1 if workers else None}


def at_most_one(*pairs: Any) -> None:
    """Raise an error if options exclude each other: names and values in turn, None for those not given."""
    given = [name for name, value in zip(pairs[::2], pairs[1::2], strict=True) if value is not None]
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
        raise click.UsageError(_name_option(str(error))) from error


def _name_option(message: str) -> str:
    """A message about an argument of a function, about the option that it comes from."""
    argument, space, rest = message.partition(" ")
    options = {"patch_size": "--patch-size", "position": "--at"} | {n: f"--{n}" for n in ("aperture", "roi", "scale")}
    return f"{options.get(argument, argument)}{space}{rest}"
