"""Types of parameters: pairs, quantities, brightness; files, patterns and pipes.

Formats are chosen by suffixes, and outputs appear whole. Input from a pipe and output to a pipe
therefore go through temporary files.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Callable, Collection, Sequence
from glob import glob, has_magic
from pathlib import Path
from typing import Any

import click

from ..image_formats import IMAGE_FORMATS, identify_format

__all__ = [
    "INPUTS",
    "BalanceValue",
    "Decorator",
    "ExposureValue",
    "InputPath",
    "OutputPath",
    "Pair",
    "Quantity",
    "is_piped",
    "name_pipes",
    "several_inputs",
]

#: Key in the context of a command: its input paths.
INPUTS = "lfcal.inputs"
# Keys in the context of a command: the temporary files that stand for stdin and for stdout.
_STDIN = "lfcal.stdin"
_STDOUT = "lfcal.stdout"
_PIPES = "lfrender-pipe-"

#: What gives a command a parameter.
Decorator = Callable[[Any], Any]
_Parameter = click.Parameter | None
_Context = click.Context | None


class _Word(click.ParamType):
    """A value that `parse` makes of a word; its ValueError is told as what the word must be."""

    name = "word"
    wanted = "a word"

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        return self.name

    def convert(self, value: Any, param: _Parameter, ctx: _Context) -> Any:
        if not isinstance(value, str):
            return value
        try:
            return self.parse(value)
        except ValueError:
            self.fail(f"must be {self.wanted}, got {value!r}", param, ctx)

    def parse(self, word: str) -> Any:
        raise NotImplementedError


class Pair(_Word):
    """Two whole numbers with an x between them: `Pair("WxH", "2048x1536")`."""

    def __init__(self, name: str, example: str) -> None:
        self.name = name
        self.wanted = f"{name} such as {example}"

    def parse(self, word: str) -> tuple[int, int]:
        found = re.fullmatch(r"\s*0*([1-9]\d{0,5})[xX]0*([1-9]\d{0,5})\s*", word)
        if not found:
            raise ValueError
        return int(found[1]), int(found[2])


class Quantity(click.FloatRange):
    """A positive number, which may stand as on lenses and boards: `f/4`, `23mm`, `5.5 um`."""

    def __init__(self, before: str = "", after: str = "") -> None:
        super().__init__(0, min_open=True)
        self._written = rf"\s*(?:{before})?\s*([-+.\d]+(?:e[-+]?\d+)?)\s*(?:{after})?\s*"

    def convert(self, value: Any, param: _Parameter, ctx: _Context) -> Any:
        number: Any = re.sub(rf"\A{self._written}\Z", r"\1", str(value), flags=re.I)
        return super().convert(number, param, ctx)


# Largest gain of a white balance: sensors that see least of a colour need about 4.
_MOST_BALANCE = 100.0


class ExposureValue(_Word):
    """A brightness: a number of EV, or `auto`."""

    name = "EV|auto"
    wanted = "auto, or a number of EV from -16 to 16"

    def parse(self, word: str) -> Any:
        if word == "auto":
            return word
        number = float(re.sub(r"\s*EV$", "", word, flags=re.I))
        if not abs(number) <= 16:
            raise ValueError
        return number


class BalanceValue(_Word):
    """A white balance: gains of red, green and blue, `auto` or `none`."""

    name = "R,G,B|auto|none"
    wanted = "auto, none or three gains such as 1.9,1,1.6"

    def parse(self, word: str) -> Any:
        if word in ("auto", "none"):
            return word
        red, green, blue = map(float, word.split(","))
        if not all(0 < gain <= _MOST_BALANCE for gain in (red, green, blue)):
            raise ValueError
        return red, green, blue


class InputPath(click.Path):
    """A file or folder to be read: its name, a pattern that it alone matches, or `-` for stdin."""

    name = "path"

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: _Parameter, ctx: _Context) -> Any:
        paths = [value] if ctx is None else _input_paths(ctx, param, [os.fspath(value)])
        if len(paths) > 1:
            self.fail(f"{value} stands for {len(paths)} files, one is wanted", param, ctx)
        return super().convert(paths[0], param, ctx)


class OutputPath(click.Path):
    """A file or folder to be written.

    `-` is stdout, in the format `piped`; `-.tif` is stdout in the format of that suffix. Before any
    work, a command refuses a file that cannot be written, has none of the `suffixes`, or is one of
    its inputs, other than the parameter `replaces`.
    """

    name = "path"

    def __init__(self, piped: str = "", replaces: str = "", suffixes: Collection[str] = ()) -> None:
        super().__init__(path_type=Path)
        self.piped = piped
        self.replaces = replaces
        self.suffixes = suffixes

    def convert(self, value: Any, param: _Parameter, ctx: _Context) -> Any:
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


def several_inputs(name: str, metavar: str) -> Decorator:
    """An argument that is any number of files, folders and patterns."""
    return click.argument(
        name, metavar=metavar, nargs=-1, required=True, callback=_input_paths, type=click.Path()
    )


def _input_paths(ctx: click.Context, _param: _Parameter, words: Sequence[str]) -> tuple[Path, ...]:
    """The paths that words stand for: a file, the files that match a pattern, or stdin."""
    paths: list[Path] = []
    for word in words:
        path = _stdin_file(ctx) if word == "-" else Path(os.path.expanduser(word))
        found: list[Path] = []
        if has_magic(word) and not path.exists():
            found = sorted(map(Path, glob(str(path), recursive=True)))
        # A pattern without matches is refused by its name, as any missing file.
        paths += found or [path]
    ctx.meta.setdefault(INPUTS, []).extend(paths)
    return tuple(paths)


def _stdin_file(ctx: click.Context) -> Path:
    if _STDIN not in ctx.meta:
        data = b""
        if not sys.stdin.isatty():
            data = sys.stdin.buffer.read()
        if not data:
            raise click.UsageError(
                "- reads the input from a pipe, but nothing came: lfrender render - -o - < flat.png"
            )
        kind = identify_format(data[:16])
        suffix = ".xml"
        if data.lstrip()[:1] == b"{":
            suffix = ".json"
        if kind:
            suffix = IMAGE_FORMATS[kind][0][0]
        ctx.meta[_STDIN] = _pipe_file(ctx, f"stdin{suffix}")
        ctx.meta[_STDIN].write_bytes(data)
    path: Path = ctx.meta[_STDIN]
    return path


def _pipe_file(ctx: click.Context, name: str) -> Path:
    folder = ctx.find_root().with_resource(tempfile.TemporaryDirectory(prefix=_PIPES))
    return Path(folder, name)


def name_pipes(text: str) -> str:
    """A text in which the files that stand for pipes are called `stdin` and `stdout`."""
    return re.sub(rf"[^\s:'\"]*{_PIPES}[^/\\]+[/\\](stdin|stdout)\.\w+", r"\1", text)


def is_piped() -> bool:
    """Whether an output of the running command goes to stdout."""
    context = click.get_current_context(silent=True)
    return context is not None and _STDOUT in context.meta
