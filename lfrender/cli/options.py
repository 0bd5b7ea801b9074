"""Commands on captures, and the options of the table that they take.

What a command works on is the same everywhere, a `CaptureInput`: its options make sense for every
command, or are refused with the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from typing import Any

import click
import cloup

from lfcal import LightFieldError
from lfcal.runtime import command_line as cl

from .inputs import CaptureInput
from .option_table import TABLE

__all__ = [
    "at_most_one",
    "capture_command",
    "connect_cluster",
    "declare",
    "option_errors",
]

#: Options of all commands on captures, by their titles in the help.
_CAPTURE = {
    "Files": ("camera", "white", "no_check", "depth_file", "dark"),
    "Depth analysis": ("preset",),
    "Reading FLAT": ("roi", "mosaic", "page", "size", "pixel_format"),
}
# Arguments of functions whose options have their names.
_ARGUMENTS = ("aperture", "depth_range", "frames", "na", "patch_size", "roi", "scale", "start")
_FIELDS = [name for names in _CAPTURE.values() for name in names]


def declare(name: str, inputs: str = "FLAT", hidden: bool = False) -> Callable[[Any], Any]:
    """An option of the table; `inputs` is what the camera is calibrated from, in the help."""
    (names, kind, text, *metavar), more = TABLE[name]
    more = {**more, "hidden": hidden, "metavar": next(iter(metavar), None)}
    return cl.option(names, kind, text.replace("FLAT", inputs), **more)


def capture_command(
    result: type[cl.Result],
    *examples: str,
    output: tuple[str, ...] = (),
    own: Mapping[str, str] | None = None,
    refused: Mapping[str, str] | None = None,
    inputs: str = "FLAT",
    several: str = "",
) -> Callable[[Any], click.Command]:
    """Make a command on captures; it is called with a `CaptureInput` and its own options.

    Its own options are `output`, as for `command_line.output_option`, and those of `own`: titles in
    the help, with names of options in the table. `refused` are options of captures that the command
    does not take, with the reason. A command that takes `several` inputs is called with all of
    them, and its camera is calibrated from the first of the `inputs`. The help shows `examples`;
    `result` is what `--json` prints.
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
            if values.get("workers") or values.get("scheduler"):
                from ..sequence.workers import check_cluster

                check_cluster()
            flat = given.inputs[0] if several else values.pop("flat")
            return function(CaptureInput(report, flat, **fields), given)

        decorated: Any = cl.report_options(result)(run)
        decorated = cl.with_options(*(declare(name, hidden=True) for name in reasons))(decorated)
        shown: dict[str, list[Callable[[Any], Any]]] = {
            "Files": [cl.output_option(*output)] if output else []
        }
        for title, names in (own or {}).items():
            shown.setdefault(title, []).extend(map(declare, names.split()))
        for title, fields in _CAPTURE.items():
            shown.setdefault(title, []).extend(
                declare(name, inputs) for name in fields if name not in reasons
            )
        # Click shows the option of the outermost decorator first.
        for title, some in reversed(shown.items()):
            if some:
                decorated = cloup.option_group(title.replace("FLAT", inputs), *some)(decorated)
        argument = click.argument("flat", type=cl.INPUT)
        if several:
            argument = cl.several_inputs("inputs", several)
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
        if argument == "position":
            argument = "--at"
        elif argument in _ARGUMENTS:
            argument = f"--{argument.replace('_', '-')}"
        raise click.UsageError(f"{argument}{space}{rest}") from error
