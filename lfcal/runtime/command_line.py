"""What command lines are made of: errors of one line, files, patterns and pipes as arguments,
progress and figures.
"""

from __future__ import annotations

import math
import os
import re
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from functools import reduce, wraps
from glob import glob, has_magic
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import cloup
import msgspec

from .errors import LightFieldError
from .image_formats import IMAGE_FORMATS, identify_format

__all__ = [
    "ExposureValue",
    "InputPath",
    "OutputPath",
    "Pair",
    "Program",
    "Quantity",
    "Report",
    "command",
    "echo",
    "name_file_in_errors",
    "option",
    "report_options",
    "several_inputs",
    "with_options",
]

# Where the context of a command keeps its inputs, the file with what came from stdin, and that for
# stdout.
_INPUTS = "lfcal.inputs"
_STDIN = "lfcal.stdin"
_STDOUT = "lfcal.stdout"

# Seconds between lines about a long step.
_TOLD_EVERY = 30.0
# Control characters but for the ends of lines, and those that turn the direction of writing.
_CONTROL = "[\x00-\x09\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]"


class Program(cloup.Group):
    """A group of commands in which an error that users can mend is one line on stderr, and exit
    code 2.

    `others` are another program and its commands, which users look for here.
    """

    def __init__(self, *args: Any, others: tuple[str, Sequence[str]], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.others = others

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        if args[0] in self.others[1]:
            ctx.fail(f"No such command {args[0]!r}. Did you mean '{self.others[0]} {args[0]}'?")
        return super().resolve_command(ctx, args)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Run as a process of its own, which Ctrl-C ends in any case."""
        from .interrupts import handle_interrupts, leave_if_interrupted

        handle_interrupts()
        try:
            return self.main(*args, **kwargs)
        except SystemExit as end:
            leave_if_interrupted(end.code if isinstance(end.code, int) else 0)
            raise
        except Exception:
            # Libraries turn an interrupt while they are imported into errors of their own.
            leave_if_interrupted(130)
            raise

    def main(self, *args: Any, **kwargs: Any) -> Any:
        if "numpy" not in sys.modules:
            # For matrices as small as ours, threads that wait for each other take several times as
            # long.
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
            sys.exit(130)
        except BrokenPipeError:
            # The reader of our output has ended; without this Python reports it again when it
            # flushes at exit.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            sys.exit(1)
        except click.ClickException as error:
            message = error.format_message()
            if isinstance(error, click.UsageError) and error.ctx:
                message += f"{'' if message.endswith(('.', '?', ')')) else '.'} See '{error.ctx.command_path} --help'."
        except MemoryError:
            message = "not enough memory for an image of this size"
        except OSError as error:
            message = f"{error.filename}: {error.strerror}" if error.filename else str(error)
        except LightFieldError as error:
            message = str(error)
        echo(f"{self.name}: {' '.join(message.split())}", err=True)
        sys.exit(2)


class _Command(cloup.Command):
    """A command whose inputs must exist; for a misspelt name, similar ones are suggested.

    Options of several values take them as one word too, with commas; one of another command is told
    which.
    """

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        several = {
            name: param.nargs for param in self.params for name in param.opts if param.nargs > 1
        }
        words: list[str] = []
        for word in args:
            numbers = re.split(r"[,;]", word) if words and words[-1] in several else []
            words += numbers if numbers and len(numbers) == several[words[-1]] else [word]
        try:
            return super().parse_args(ctx, words)
        except click.NoSuchOption as error:
            group = ctx.parent.command if ctx.parent else None
            others = [
                name
                for name, other in getattr(group, "commands", {}).items()
                if other is not self
                and any(error.option_name in param.opts for param in other.params)
            ]
            if others:
                belongs = f"No such option: {error.option_name}; it belongs to {', '.join(others)}"
                raise click.UsageError(belongs, ctx) from error
            raise

    def invoke(self, ctx: click.Context) -> Any:
        for path in ctx.meta.get(_INPUTS, ()):
            if not path.exists():
                names = os.listdir(path.parent) if path.parent.is_dir() else []
                similar = [
                    str(path.with_name(name)) for name in get_close_matches(path.name, names, 2)
                ]
                ending = f"; did you mean {' or '.join(similar)}?" if similar else ""
                raise click.ClickException(f"{path}: does not exist{ending}")
            if not (path.is_file() or path.is_dir()):
                raise click.ClickException(
                    f"{path}: is a device or a pipe; give a file, or - for a pipe"
                )
        return super().invoke(ctx)


def command(*examples: str) -> Callable[[Any], cloup.Command]:
    """Make a function a command, whose help ends with examples of how it is called."""
    lines = "\n".join(f"  {line}" for line in examples)
    return cloup.command(cls=_Command, epilog=f"\b\nExamples:\n{lines}")


def option(
    names: str, kind: Any, text: str, metavar: str | None = None, **more: Any
) -> Callable[[Any], Any]:
    """`click.option`: all its names, the type of its value (bool: a flag), and its help."""
    more |= {"is_flag": True} if kind is bool else {"type": kind}
    return click.option(*names.split(), help=text, metavar=metavar, **more)


def with_options(*options: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Give a command some options, the first of which its help shows first."""
    return lambda function: reduce(lambda given, add: add(given), reversed(options), function)


def report_options(function: Callable[[Report, Any], Any]) -> Callable[..., Any]:
    """Give a command `--json`, `--quiet`, `--verbose`; its function gets a `Report` and the values
    of its options.
    """

    @with_options(
        option("--json as_json", bool, "Print the figures as one JSON object."),
        option("--quiet", bool, "Print nothing but warnings."),
        option(
            "--verbose",
            bool,
            "Print each stage on stderr, with its seconds, as soon as it has ended.",
        ),
    )
    @wraps(function)
    def run(as_json: bool, quiet: bool, verbose: bool, **values: Any) -> Any:
        return function(Report(as_json, quiet, verbose), SimpleNamespace(**values))

    return run


class Pair(click.ParamType):
    """Two whole numbers with an x between them: `Pair("WxH", "2048x1536")`."""

    def __init__(self, name: str, example: str) -> None:
        self.name, self.example = name, example

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        return self.name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        found = re.fullmatch(r"\s*0*([1-9]\d{0,5})[xX]0*([1-9]\d{0,5})\s*", str(value))
        if not found and not isinstance(value, tuple):
            self.fail(f"must be {self.name} such as {self.example}, got {value!r}", param, ctx)
        return (int(found[1]), int(found[2])) if found else value


class Quantity(click.FloatRange):
    """A positive number, which may stand as on lenses and boards: `f/4`, `23mm`, `5.5 um`."""

    def __init__(self, before: str = "", after: str = "") -> None:
        super().__init__(0, min_open=True)
        self._written = rf"\s*(?:{before})?\s*([-+.\d]+(?:e[-+]?\d+)?)\s*(?:{after})?\s*"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        found = re.fullmatch(self._written, str(value), re.I)
        number: Any = found[1] if found else value
        return super().convert(number, param, ctx)


class ExposureValue(click.ParamType):
    """A brightness: a number of EV, or `auto`."""

    name = "EV|auto"

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        return self.name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "auto":
            return value
        try:
            number = float(re.sub(r"\s*EV$", "", str(value), flags=re.I))
        except ValueError:
            number = math.nan
        if not abs(number) <= 16:
            self.fail(f"must be auto, or a number of EV from -16 to 16, got {value!r}", param, ctx)
        return number


class InputPath(click.Path):
    """A file or folder to be read: its name, a pattern that it alone matches, or `-` for stdin."""

    name = "path"

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        paths = [value] if ctx is None else _input_paths(ctx, param, [os.fspath(value)])
        if len(paths) > 1:
            self.fail(f"{value} stands for {len(paths)} files, one is wanted", param, ctx)
        return super().convert(paths[0], param, ctx)


class OutputPath(click.Path):
    """A file or folder to be written; `-` is stdout, in the format `piped`, and `-.tif` and the
    like name another.
    """

    name = "path"

    def __init__(self, piped: str = "") -> None:
        super().__init__(path_type=Path)
        self.piped = piped

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if ctx is None or not (value == "-" or str(value).startswith("-.")):
            return super().convert(value, param, ctx)
        if not self.piped:
            self.fail("cannot be written to stdout; give a name", param, ctx)
        if _STDOUT in ctx.meta:
            self.fail("only one output can go to stdout", param, ctx)
        path = ctx.meta[_STDOUT] = _pipe_file(ctx, f"stdout{value[1:] or self.piped}")

        def copy_to_stdout() -> None:
            if path.is_file():
                sys.stdout.buffer.write(path.read_bytes())
                sys.stdout.buffer.flush()

        ctx.find_root().call_on_close(copy_to_stdout)
        return path


def several_inputs(name: str, metavar: str) -> Callable[[Any], Any]:
    """An argument that is any number of files, folders and patterns."""
    return click.argument(
        name, metavar=metavar, nargs=-1, required=True, callback=_input_paths, type=click.Path()
    )


def _input_paths(
    ctx: click.Context, _param: click.Parameter | None, words: Sequence[str]
) -> tuple[Path, ...]:
    """The paths that words stand for: a file of that name, what it matches as a pattern, or stdin."""
    paths: list[Path] = []
    for word in words:
        path = _stdin_file(ctx) if word == "-" else Path(os.path.expanduser(word))
        # A pattern without matches is refused by its name, as any missing file.
        found = (
            sorted(glob(str(path), recursive=True)) if has_magic(word) and not path.exists() else []
        )
        paths += map(Path, found) if found else [path]
    ctx.meta.setdefault(_INPUTS, []).extend(paths)
    return tuple(paths)


# Formats are chosen by suffixes, and outputs appear whole: pipes go through files.
def _stdin_file(ctx: click.Context) -> Path:
    if _STDIN not in ctx.meta:
        data = b"" if sys.stdin.isatty() else sys.stdin.buffer.read()
        if not data:
            raise click.UsageError(
                "- reads the input from a pipe, but nothing came: lfrender render - -o - < flat.png"
            )
        kind = identify_format(data[:16])
        suffix = (
            IMAGE_FORMATS[kind][0][0] if kind else ".json" if data.lstrip()[:1] == b"{" else ".xml"
        )
        ctx.meta[_STDIN] = _pipe_file(ctx, f"stdin{suffix}")
        ctx.meta[_STDIN].write_bytes(data)
    path: Path = ctx.meta[_STDIN]
    return path


def _pipe_file(ctx: click.Context, name: str) -> Path:
    return (
        Path(ctx.find_root().with_resource(tempfile.TemporaryDirectory(prefix="lfrender-pipe-")))
        / name
    )


def echo(text: object, err: bool = False) -> None:
    """Print a line in which texts of files and names cannot steer the terminal: control characters
    are shown as codes.

    Files that stand for pipes are called `stdin` and `stdout`.
    """
    shown = re.sub(
        _CONTROL, lambda match: match[0].encode("unicode_escape").decode(), _name_pipes(str(text))
    )
    click.echo(shown, err=err)


def _name_pipes(text: str) -> str:
    """A text in which the files that stand for pipes are called `stdin` and `stdout`."""
    return re.sub(r"[^\s:'\"]*lfrender-pipe-[^/\\]+[/\\](stdin|stdout)\.\w+", r"\1", text)


class Report:
    """Progress and figures of one command, as `--json`, `--quiet` and `--verbose` ask for."""

    def __init__(self, as_json: bool = False, quiet: bool = False, verbose: bool = False) -> None:
        self.as_json, self.quiet, self.verbose = as_json, quiet, verbose
        self.seconds: dict[str, float] = {}
        #: Of compiling kernels, in the first command of an installation.
        self.compile_seconds = 0.0
        self.warnings: list[str] = []
        self._shown: Any = None
        if sys.stderr.isatty() and not quiet:
            from rich.console import Console
            from rich.progress import Progress, TextColumn

            columns = *Progress.get_default_columns()[:2], TextColumn("{task.fields[rate]}")
            self._shown = Progress(*columns, console=Console(stderr=True), transient=True)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage, and show it on a terminal while it runs."""
        self.compile_kernels()
        start = time.perf_counter()
        with self.progress(name):
            yield
        self.seconds[name] = time.perf_counter() - start
        if self.verbose:
            click.echo(f"{name}: {self.seconds[name]:.3f} s", err=True)

    @contextmanager
    def progress(self, name: str) -> Iterator[Callable[..., None]]:
        """Gives a function to call with the numbers of finished and of all steps (None: not known),
        and a remark.

        On a terminal a bar shows rate and remaining time.
        """
        start = time.perf_counter()
        before = -1
        shown = self._shown

        def step(done: int, count: int | None, remark: str = "") -> None:
            nonlocal before
            # What an earlier run has done says nothing about the rate.
            before = done - 1 if before < 0 else before
            if remark and not self.quiet:
                echo(remark, err=True)
            if shown is not None:
                rate = (done - before) / (time.perf_counter() - start)
                left = "" if count is None else f", {(count - done) / rate:.0f} s left"
                text = f"{done}/{count or '?'}, {rate:.2f} a second{left}"
                shown.update(task, completed=done, total=count, rate=text)

        if shown is None:
            yield step
            return
        shown.start()
        task = shown.add_task(name, total=None, rate="")
        try:
            yield step
        finally:
            shown.remove_task(task)
            shown.stop() if not shown.tasks else None

    def compile_kernels(self, processes: int | None = None) -> int | None:
        """Compile all kernels, if that has not been done for this installation; returns how many
        could not be.

        None where nothing was to be done.
        """
        from .compile_ahead import compile_once, is_compiled

        if self.compile_seconds or is_compiled():
            return None
        if not self.quiet:
            about = "once per installation: a minute or two on two cores, more on a busy machine"
            self._echo(f"compiling kernels, {about} ...")
        start = time.perf_counter()
        with self.progress("compiling kernels") as step:
            failed = compile_once(
                processes, step if self._shown or self.quiet else _tell_at_times(start)
            )
        self.compile_seconds = time.perf_counter() - start
        return failed

    def warn(self, text: str) -> None:
        """Add a warning to those that are printed at the end."""
        self.warnings.append(text)

    @property
    def took(self) -> str:
        """The seconds of all stages so far, for a closing sentence, and those of compiling kernels
        before.
        """
        before = (
            f" (after {self.compile_seconds:.0f} s of compiling, once)"
            if self.compile_seconds >= 1
            else ""
        )
        seconds = sum(self.seconds.values())
        whole = (
            f"{seconds:.{2 if seconds < 1 else 1}f} s"
            if seconds < 100
            else f"{seconds / 60:.1f} min"
        )
        return whole + before

    def finish(self, figures: Mapping[str, Any], *sentences: str) -> None:
        """Print the warnings among the figures on stderr, and sentences that sum the figures up.

        With `--json`, print all figures with the seconds of all stages; without any sentence, print
        them as a table.
        """
        found = {**figures, "warnings": [*figures.get("warnings", ()), *self.warnings]}
        if self.seconds or self.as_json:
            found["seconds"] = {name: round(value, 4) for name, value in self.seconds.items()}
        if self.as_json:
            # NaN and infinity are null.
            text = msgspec.json.encode(found, enc_hook=_built_in).decode()
            # JSON has escapes for those below space, which this text has already; these ones it may
            # hold as they are.
            text = re.sub("[\x7f-\x9f]", lambda match: f"\\u{ord(match[0]):04x}", text)
            echo(text, err=_is_piped())
            return
        for warning in found.pop("warnings"):
            echo(f"warning: {warning}", err=True)
        width = max(map(len, found)) + 2
        table = (
            f"{name.replace('_', ' '):{width}}{_text(value, width)}"
            for name, value in found.items()
        )
        for line in () if self.quiet else sentences or table:
            self._echo(line)

    def _echo(self, line: str) -> None:
        echo(line, err=self.as_json or _is_piped())


@contextmanager
def name_file_in_errors(path: str | os.PathLike[str]) -> Iterator[None]:
    """Put the name of a file before errors that do not have it."""
    try:
        yield
    except LightFieldError as error:
        if str(path) in str(error):
            raise
        raise type(error)(f"{path}: {error}") from error


def _tell_at_times(start: float) -> Callable[[int, int], None]:
    """Where nothing is a terminal: a line about the progress every half a minute, so that nobody
    thinks it hangs.
    """
    told = start

    def step(done: int, count: int) -> None:
        nonlocal told
        if time.perf_counter() - told >= _TOLD_EVERY:
            told = time.perf_counter()
            echo(f"compiling kernels: {done} of {count} after {told - start:.0f} s", err=True)

    return step


def _is_piped() -> bool:
    context = click.get_current_context(silent=True)
    return context is not None and _STDOUT in context.meta


def _built_in(value: Any) -> Any:
    return str(value) if isinstance(value, os.PathLike) else value.tolist()


def _text(value: Any, indent: int = 0) -> str:
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, Mapping):
        return f"\n{' ' * indent}".join(
            f"{key.replace('_', ' ')} {_text(item)}" for key, item in value.items()
        )
    if isinstance(value, (list, tuple)):
        return "  ".join(map(_text, value))
    if isinstance(value, float):
        return f"{value:.5g}" if math.isfinite(value) else "unknown"
    return "unknown" if value is None else str(value)
