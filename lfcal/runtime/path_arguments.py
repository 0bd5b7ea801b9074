"""Files and folders on a command line as people type them: patterns, several where one is wanted, typos."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from glob import glob, has_magic
from pathlib import Path
from typing import Any

import click

from .errors import LightFieldError

__all__ = ["InputPath", "several_inputs", "single_input", "suggest_similar_names"]

# Where a command keeps the inputs it was given.
_INPUTS = "lfcal.inputs"


class InputPath(click.Path):
    """A file or folder to be read; a pattern that the shell has left as it is stands for the one path that matches."""

    name = "path"

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        found = _matching(os.fspath(value))
        if len(found) > 1:
            self.fail(f"{value} stands for {len(found)} files, one is wanted", param, ctx)
        if ctx is not None:
            ctx.meta.setdefault(_INPUTS, []).append(found[0])
        return super().convert(found[0], param, ctx)


def single_input(name: str, instead: str = "") -> Callable[[Any], Any]:
    """An argument that is one file; `instead` says which command takes several."""

    def one(ctx: click.Context, param: click.Parameter, values: Sequence[str]) -> Path:
        paths = [path for value in values for path in _matching(value)]
        if len(paths) > 1:
            # Words after a file are mostly options that lack their dashes.
            more = f"; {instead}" if instead and all(path.exists() for path in paths) else ""
            raise click.UsageError(f"{name} is one file, got {len(paths)}: {_listed(paths)}{more}", ctx)
        ctx.meta.setdefault(_INPUTS, []).extend(paths)
        return paths[0]

    return click.argument(name.lower(), metavar=name, nargs=-1, required=True, callback=one, type=click.Path())


def several_inputs(name: str, metavar: str) -> Callable[[Any], Any]:
    """An argument that is any number of files and folders."""

    def all_of(ctx: click.Context, param: click.Parameter, values: Sequence[str]) -> tuple[Path, ...]:
        paths = tuple(path for value in values for path in _matching(value))
        ctx.meta.setdefault(_INPUTS, []).extend(paths)
        return paths

    return click.argument(name, metavar=metavar, nargs=-1, required=True, callback=all_of, type=click.Path())


@contextmanager
def suggest_similar_names(ctx: click.Context) -> Iterator[None]:
    """Let errors about inputs that are not there name the files that are called like them."""
    try:
        yield
    except (LightFieldError, OSError) as error:
        absent = [path for path in ctx.meta.get(_INPUTS, ()) if not path.exists() and str(path) in str(error)]
        near = [name for path in absent[:1] for name in _alike(path)]
        if not near:
            raise
        raise click.ClickException(f"{_words(error)}; did you mean {' or '.join(near)}?") from error


def _words(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}"
    return str(error)


def _matching(text: str) -> list[Path]:
    """The paths a word stands for: itself where it is there, else what it matches as a pattern."""
    if os.path.exists(text) or not text:
        return [Path(text)]
    # Behind an equals sign shells leave the tilde as it is.
    text = os.path.expanduser(text)
    if not has_magic(text):
        return [Path(text)]
    # What matches nothing is refused by its name, as any file that is not there.
    return [Path(path) for path in sorted(glob(text, recursive=True)) or [text]]


def _alike(path: Path) -> list[str]:
    """Files in the folder of a path that are called like it, or folders like its own where that is not there."""
    missing = path
    while not missing.parent.exists() and missing.parent != missing:
        missing = missing.parent
    try:
        names = [entry.name for entry in missing.parent.iterdir() if not entry.name.startswith(".")]
    except OSError:
        return []
    near = get_close_matches(missing.name, names, 2, 0.7)
    # The same name with another ending is what is meant most often.
    same = sorted(name for name in names if Path(name).stem == missing.stem and name not in near)
    return [str(missing.with_name(name)) for name in [*same, *near][:2]]


def _listed(paths: Sequence[Path]) -> str:
    return ", ".join(map(str, paths[:3])) + (", ..." if len(paths) > 3 else "")
