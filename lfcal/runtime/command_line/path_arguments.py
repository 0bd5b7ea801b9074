"""Files and folders on a command line: patterns, several where one is wanted, misspelt names."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from glob import glob, has_magic
from pathlib import Path
from typing import Any

import click

from ..errors import LightFieldError
from ..video.raw_format import parse_size
from .pipes import is_pipe, stdin_file, stdout_file

__all__ = [
    "InputPath",
    "OutputPath",
    "SizeOption",
    "page_option",
    "raw_video_options",
    "several_inputs",
    "single_input",
    "suggest_similar_names",
]

# Where the context of a command keeps the inputs it was given.
_INPUTS = "lfcal.inputs"


class InputPath(click.Path):
    """A file or folder to be read; a pattern that the shell has not expanded stands for the one path that matches."""

    name = "path"

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "-" and ctx is not None:
            return stdin_file(ctx)
        paths = _expand(os.fspath(value))
        if len(paths) > 1:
            self.fail(f"{value} stands for {len(paths)} files, one is wanted", param, ctx)
        if ctx is not None:
            ctx.meta.setdefault(_INPUTS, []).append(paths[0])
        return super().convert(paths[0], param, ctx)


class OutputPath(click.Path):
    """A file or folder to be written; `-` is stdout, in the format `piped`, and `-.tif` and the like name another."""

    name = "path"

    def __init__(self, piped: str = "") -> None:
        super().__init__(path_type=Path)
        self.piped = piped

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if isinstance(value, str) and is_pipe(value) and ctx is not None:
            if not self.piped:
                self.fail("cannot be written to stdout; give a name", param, ctx)
            return stdout_file(ctx, value[1:] or self.piped)
        return super().convert(value, param, ctx)


def single_input(name: str, hint: str = "", folder_hint: str = "") -> Callable[[Any], Any]:
    """An argument that is one file; `hint` names the command for several, `folder_hint` that for a folder `{}`."""

    def one(ctx: click.Context, param: click.Parameter, values: Sequence[str]) -> Path:
        paths = _all_inputs(ctx, param, values)
        if folder_hint and len(paths) == 1 and paths[0].is_dir() and paths[0].suffix.lower() != ".zarr":
            raise click.UsageError(f"{paths[0]} is a folder; {folder_hint.format(paths[0])}", ctx)
        if len(paths) > 1:
            # Words after a file are mostly options without their dashes: then the hint does not help.
            end = f"; {hint}" if hint and all(path.exists() for path in paths) else ""
            listed = ", ".join(map(str, paths[:3])) + (", ..." if len(paths) > 3 else "")
            raise click.UsageError(f"{name} is one file, got {len(paths)}: {listed}{end}", ctx)
        return paths[0]

    return click.argument(name.lower(), metavar=name, nargs=-1, required=True, callback=one, type=click.Path())


class SizeOption(click.ParamType):
    """Width and height, such as 2048x2048."""

    name = "WxH"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if isinstance(value, tuple):
            return value
        try:
            return parse_size(value)
        except ValueError as error:
            self.fail(str(error), param, ctx)


def page_option(command: Any) -> Any:
    """Give a command the option `--page`."""
    text = "Which picture of a TIFF of several, or frame of a video, from 0."
    return click.option("--page", type=click.IntRange(0), metavar="N", help=text)(command)


def raw_video_options(command: Any) -> Any:
    """Give a command the options `--size` and `--pixel-format` of raw video."""
    command = click.option("--pixel-format", metavar="FORMAT", help="Of raw video: yuv420p10, yuv444p, ...")(command)
    return click.option("--size", type=SizeOption(), help="Of raw video (.yuv), if its name does not have it.")(command)


def several_inputs(name: str, metavar: str) -> Callable[[Any], Any]:
    """An argument that is any number of files and folders."""
    return click.argument(name, metavar=metavar, nargs=-1, required=True, callback=_all_inputs, type=click.Path())


def _all_inputs(ctx: click.Context, _param: click.Parameter, values: Sequence[str]) -> tuple[Path, ...]:
    paths = tuple(path for value in values for path in ([stdin_file(ctx)] if value == "-" else _expand(value)))
    ctx.meta.setdefault(_INPUTS, []).extend(paths)
    return paths


@contextmanager
def suggest_similar_names(ctx: click.Context) -> Iterator[None]:
    """Add the names of similar files to errors about inputs that do not exist."""
    try:
        yield
    except (LightFieldError, OSError) as error:
        absent = [path for path in ctx.meta.get(_INPUTS, ()) if not path.exists() and str(path) in str(error)]
        similar = [name for path in absent[:1] for name in _similar_names(path)]
        if not similar:
            raise
        message = f"{error.filename}: {error.strerror}" if isinstance(error, OSError) and error.filename else str(error)
        raise click.ClickException(f"{message}; did you mean {' or '.join(similar)}?") from error


def _expand(text: str) -> list[Path]:
    """The paths that a word stands for: itself if it exists, else what it matches as a pattern."""
    if os.path.exists(text) or not text:
        return [Path(text)]
    # Shells do not expand a tilde after an equals sign.
    text = os.path.expanduser(text)
    if not has_magic(text):
        return [Path(text)]
    # A pattern without matches is refused by its name, as any missing file.
    return [Path(path) for path in sorted(glob(text, recursive=True)) or [text]]


def _similar_names(path: Path) -> list[str]:
    """At most two similar names in the folder of a path, or similar folders where that does not exist."""
    missing = path
    while not missing.parent.exists() and missing.parent != missing:
        missing = missing.parent
    try:
        names = [entry.name for entry in missing.parent.iterdir() if not entry.name.startswith(".")]
    except OSError:
        return []
    near = get_close_matches(missing.name, names, 2, 0.7)
    # The most frequent mistake is a wrong suffix.
    same = sorted(name for name in names if Path(name).stem == missing.stem and name not in near)
    return [str(missing.with_name(name)) for name in [*same, *near][:2]]
