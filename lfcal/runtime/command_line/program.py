"""Programs of several commands: errors of one line, exit codes, and hints for mistyped names."""

from __future__ import annotations

import os
import re
import sys
import warnings
from collections.abc import Callable, Collection
from difflib import SequenceMatcher
from functools import reduce, wraps
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import cloup

from ..errors import LightFieldError
from ..output_file import check_output, refuse_inputs
from .interrupts import INTERRUPTED, handle_interrupts, leave_if_interrupted
from .parameters import INPUTS, Decorator, InputPath, OutputPath, Pair, name_pipes
from .report import Report, echo, echo_json
from .result import VERSION, Failure

__all__ = [
    "DARK",
    "INPUT",
    "READING",
    "SIZE",
    "Program",
    "command",
    "option",
    "output_option",
    "report_options",
    "with_options",
]


#: Key in the context of a program: whether `--json` is among the words.
_WANTS_JSON = "lfcal.json"
_USER_ERRORS = (click.ClickException, LightFieldError, MemoryError, OSError)


class Program(cloup.Group):
    """A group of commands that reports each error a user can mend as one line with exit code 2.

    `others` are another program and the names of its commands, in one text: users who look for
    them here learn where they are.
    """

    def __init__(self, *args: Any, others: tuple[str, str], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.others = others

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        program, commands = self.others
        if args[0] in commands.split():
            ctx.fail(f"No such command {args[0]!r}. Did you mean '{program} {args[0]}'?")
        return super().resolve_command(ctx, args)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Run as a process of its own, which Ctrl-C ends in any case."""
        handle_interrupts()
        try:
            return self.main(*args, **kwargs)
        except SystemExit as end:
            leave_if_interrupted(end.code if isinstance(end.code, int) else 0)
            raise
        except Exception:
            # Libraries turn an interrupt while they are imported into errors of their own.
            leave_if_interrupted(INTERRUPTED)
            raise

    def main(self, *args: Any, **kwargs: Any) -> Any:
        if "numpy" not in sys.modules:
            # Our matrices are small: threads that wait for each other take several times as long.
            os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        try:
            # Python warnings are for developers; results have warnings of their own for users.
            with warnings.catch_warnings():
                if not sys.warnoptions:
                    warnings.simplefilter("ignore")
                code = super().main(*args, **{**kwargs, "standalone_mode": False})
            sys.exit(code if isinstance(code, int) else 0)
        except click.exceptions.NoArgsIsHelpError as error:
            error.show()
            sys.exit(2)
        except (KeyboardInterrupt, click.Abort):
            click.echo("interrupted", err=True)
            sys.exit(INTERRUPTED)
        except BrokenPipeError:
            # The reader of our output has ended. Python would report it again at exit.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            sys.exit(1)
        except _USER_ERRORS as error:
            echo(f"{self.name}: {_explain(error)}", err=True)
        sys.exit(2)

    def make_context(
        self, info_name: str | None, args: list[str], *more: Any, **kwargs: Any
    ) -> click.Context:
        wants_json = "--json" in args
        context = super().make_context(info_name, args, *more, **kwargs)
        context.meta[_WANTS_JSON] = wants_json
        return context

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; with `--json`, an error that users can mend is printed as an object."""
        try:
            return super().invoke(ctx)
        except _USER_ERRORS as error:
            if ctx.meta.get(_WANTS_JSON) and not isinstance(error, BrokenPipeError):
                failure = Failure.of(error, name_pipes(_explain(error)))
                echo_json({"version": VERSION, "error": failure})
            raise


def _explain(error: BaseException) -> str:
    """An error that users can mend, in one line."""
    message = str(error)
    if isinstance(error, click.ClickException):
        message = error.format_message()
    if isinstance(error, click.UsageError) and error.ctx:
        stop = "."
        if message.endswith((".", "?", ")")):
            stop = ""
        message += f"{stop} See '{error.ctx.command_path} --help'."
    elif isinstance(error, MemoryError):
        message = "not enough memory for an image of this size"
    elif isinstance(error, OSError) and error.filename:
        message = f"{error.filename}: {error.strerror}"
    return " ".join(message.split())


# Names are suggested whose letters before the suffix are the same to this share.
_SIMILAR = 0.75


def _similarity(path: Path, name: str) -> float:
    """How similar a name is to that of a path, without the suffixes; 1 of equal ones."""
    return SequenceMatcher(None, path.stem.lower(), Path(name).stem.lower()).ratio()


class _Command(cloup.Command):
    """A command whose inputs must exist; similar names are suggested for a mistyped one.

    The values of an option that takes several may stand in one word, with commas between. An
    option of another command is refused with the name of that command.
    """

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        several = {
            name: param.nargs for param in self.params for name in param.opts if param.nargs > 1
        }
        words: list[str] = []
        for word in args:
            numbers = re.split(r"[,;]", word)
            in_one_word = words and several.get(words[-1]) == len(numbers)
            words += numbers if in_one_word else [word]
        try:
            return super().parse_args(ctx, words)
        except click.NoSuchOption as error:
            files = [word for word in args if word[:1] == "-" and os.path.exists(word)]
            if files:
                belongs = f"{files[0]} is taken for an option: write ./{files[0]} for the file"
                raise click.UsageError(belongs, ctx) from error
            owners = self._find_owners(ctx, error.option_name)
            if not owners:
                raise
            belongs = f"No such option: {error.option_name}; it belongs to {', '.join(owners)}"
            raise click.UsageError(belongs, ctx) from error

    def _find_owners(self, ctx: click.Context, option: str) -> list[str]:
        """Names of the other commands of the program that have an option."""
        commands = getattr(ctx.parent and ctx.parent.command, "commands", {})
        return [
            name
            for name, other in commands.items()
            if any(option in param.opts for param in other.params)
        ]

    def invoke(self, ctx: click.Context) -> Any:
        for path in ctx.meta.get(INPUTS, ()):
            if not path.exists():
                names = []
                if path.parent.is_dir():
                    names = os.listdir(path.parent)
                alike = {name: _similarity(path, name) for name in names}
                similar = sorted(
                    (name for name in names if alike[name] >= _SIMILAR),
                    key=lambda name: (-alike[name], name),
                )[:2]
                hint = " or ".join(str(path.with_name(name)) for name in similar)
                ending = ""
                if hint:
                    ending = f"; did you mean {hint}?"
                raise click.ClickException(f"{path}: does not exist{ending}")
            if not (path.is_file() or path.is_dir()):
                raise click.ClickException(
                    f"{path}: is a device or a pipe; give a file, or - for a pipe"
                )
        self._check_outputs(ctx)
        return super().invoke(ctx)

    def _check_outputs(self, ctx: click.Context) -> None:
        """Refuse two outputs of one name, and outputs that would replace an input."""
        outputs: dict[str, str] = {}
        for param in self.params:
            path = ctx.params[param.name or ""]
            if path is None or not isinstance(param.type, OutputPath):
                continue
            option = param.opts[-1]
            first = outputs.setdefault(os.path.realpath(path), option)
            if first != option:
                raise click.UsageError(f"{first} and {option} name the same output {path}", ctx)
            if param.type.suffixes:
                check_output(path, param.type.suffixes)
            # A Zarr array is a folder.
            if path.suffix.lower() == ".zarr" or not path.is_dir():
                replaced = ctx.params.get(param.type.replaces)
                refuse_inputs(path, [file for file in ctx.meta.get(INPUTS, ()) if file != replaced])


def command(*examples: str) -> Callable[[Any], cloup.Command]:
    """Make a function a command whose help ends with examples of its use."""
    lines = "\n".join(f"  {line}" for line in examples)
    return cloup.command(cls=_Command, epilog=f"\b\nExamples:\n{lines}")


def option(names: str, kind: Any, text: str, metavar: str | None = None, **more: Any) -> Decorator:
    """`click.option` with all its names, the type of its value (bool: a flag), and its help."""
    more |= {"is_flag": True} if kind is bool else {"type": kind}
    return click.option(*names.split(), help=text, metavar=metavar, **more)


def output_option(
    metavar: str,
    text: str,
    piped: str = "",
    replaces: str = "",
    suffixes: Collection[str] = (),
    **more: Any,
) -> Decorator:
    """The option `--output`; `piped` is the format on stdout with `-`, empty if refused.

    The output has one of the `suffixes`, if they are given, and may replace the input `replaces`.
    """
    if piped:
        text += f" With -, {piped[1:].upper()} to stdout."
    more.setdefault("required", True)
    return option("-o --output", OutputPath(piped, replaces, suffixes), text, metavar, **more)


#: Type of an argument that names a file to read.
INPUT = InputPath()
#: Type of an option that is the size of a flat.
SIZE = Pair("WxH", "2048x1536")
#: Option of commands that read flats, in the form of `option`.
DARK = ("--dark", INPUT, "Dark frame that is subtracted from all flats and white images.")
#: Options of commands that read flats, in the form of `option`, by the name of the value.
READING: dict[str, tuple[Any, ...]] = {
    "page": (
        "--page",
        click.IntRange(0),
        "Which picture of a TIFF of several, or frame of a video, from 0.",
        "N",
    ),
    "size": ("--size", SIZE, "Of raw video (.yuv), if its name does not have it."),
    "pixel_format": ("--pixel-format", str, "Of raw video: yuv420p10, yuv444p, ...", "FORMAT"),
}


def with_options(*options: Decorator) -> Decorator:
    """Give a command options; its help shows them in this order."""
    return lambda function: reduce(lambda given, add: add(given), reversed(options), function)


def report_options(result: Callable[..., Any]) -> Decorator:
    """Give a command `--json`, `--quiet` and `--verbose`; `--json` prints a `result`.

    Its function is called with a `Report` and the values of its other options.
    """

    def decorate(function: Callable[[Report, Any], Any]) -> Callable[..., Any]:
        @with_options(
            option("--json as_json", bool, "Print the figures, or an error, as one JSON object."),
            option("--quiet", bool, "Print nothing but warnings."),
            option("--verbose", bool, "Print the seconds of each stage on stderr when it ends."),
        )
        @wraps(function)
        def run(as_json: bool, quiet: bool, verbose: bool, **values: Any) -> Any:
            report = Report(as_json, quiet, verbose, result)
            return function(report, SimpleNamespace(**values))

        run.result = result  # type: ignore[attr-defined]
        return run

    return decorate
