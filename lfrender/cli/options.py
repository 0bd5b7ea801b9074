"""Commands on captures, and the options of the table that they take.

What a command works on is the same everywhere, a `CaptureInput`: its options make sense for every
command, or are refused with the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from typing import Any

import click
import cloup

from lfcal import LightFieldError
from lfcal.runtime import command_line as cl

from ..runtime.types import Entries
from .inputs import CaptureInput
from .option_table import TABLE

__all__ = [
    "RESULTS",
    "capture_command",
    "connect_cluster",
    "declare",
    "option_errors",
    "refuse_together",
]

#: What the commands print with `--json`.
RESULTS = cl.results_of(__package__)
#: Options of all commands on captures, by their titles in the help.
_CAPTURE = {
    "Files": ("camera", "white", "no_check", "depth_file", "dark"),
    "Depth analysis": ("preset",),
    "Reading FLAT": ("roi", "mosaic", "page", "size", "pixel_format"),
}
# Arguments of functions whose options have their names.
_ARGUMENTS = ("aperture", "depth_range", "frames", "na", "patch_size", "roi", "scale", "start")
_FIELDS = [name for names in _CAPTURE.values() for name in names]
# Options of which at most one may be given, wherever a command has several of them.
_EXCLUSIVE = ("camera white", "workers scheduler", "scale resize")


def declare(name: str, inputs: str = "FLAT", hidden: bool = False) -> Callable[[Any], Any]:
    """An option of the table; `inputs` is what the camera is calibrated from, in the help."""
    (names, kind, text, *metavar), more = TABLE[name]
    more = {**more, "hidden": hidden, "metavar": next(iter(metavar), None)}
    return cl.option(names, kind, text.replace("FLAT", inputs), **more)


def capture_command(
    result: str,
    *examples: str,
    output: tuple[Any, ...] = (),
    own: Mapping[str, str] | None = None,
    refused: Mapping[str, str] | None = None,
    exclusive: Iterable[str] = (),
    inputs: str = "FLAT",
    several: str = "",
) -> Callable[[Any], click.Command]:
    """Make a command on captures; it is called with a `CaptureInput` and its own options.

    Its own options are `output`, as for `command_line.output_option`, and those of `own`: titles in
    the help, with names of options in the table. `refused` are options of captures that the command
    does not take, with the reason; of the options in each text of `exclusive` at most one may be
    given. A command that takes `several` inputs is called with all of
    them, and its camera is calibrated from the first of the `inputs`. The help shows `examples`;
    `result` is the name of what `--json` prints.
    """
    reasons = refused or {}

    def decorate(function: Any) -> click.Command:
        @wraps(function)
        def run(report: cl.Report, given: Any) -> Any:
            values = vars(given)
            refuse_together(values, *_EXCLUSIVE, *exclusive)
            fields = {name: values.pop(name) for name in _FIELDS}
            for name, reason in reasons.items():
                if fields[name] is not None:
                    raise click.UsageError(f"{_long_name(name)} makes no sense here: {reason}")
            if values.get("workers") or values.get("scheduler"):
                from ..sequence.workers import check_cluster

                check_cluster()
            flat = given.inputs[0] if several else values.pop("flat")
            return function(CaptureInput(report, flat, **fields), given)

        decorated: Any = cl.report_options(RESULTS[result])(run)
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
def connect_cluster(given: Any, report: cl.Report) -> Iterator[Entries]:
    """The arguments for work on the processes or the scheduler that `given` names."""
    if not (given.workers or given.scheduler):
        yield {}
        return
    from ..sequence.workers import connect

    # Or each worker on this machine would.
    report.compile_kernels()
    with connect(given.workers, given.scheduler) as client:
        yield {"client": client, "threads": 1 if given.workers else None}


def _long_name(name: str) -> str:
    """The option of a value, as it is written."""
    return next(word for word in TABLE[name][0][0].split() if word.startswith("--"))


def refuse_together(values: Mapping[str, Any], *groups: str) -> None:
    """Raise an error if several options of a group are given, whose names are in one text."""
    for group in groups:
        given = [name for name in group.split() if values.get(name) not in (None, False, ())]
        if len(given) > 1:
            one, other = map(_long_name, given[:2])
            raise click.UsageError(f"{one} and {other} exclude each other")


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
