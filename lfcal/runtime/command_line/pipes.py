"""`-` in the place of a file: the input is read from stdin, the output is written to stdout.

Both go through a file of a temporary folder, since formats are chosen by suffixes and outputs are written whole.
"""

from __future__ import annotations

import re
import shutil
import sys
import tempfile
from pathlib import Path

import click

from ..image_formats import IMAGE_FORMATS, identify_format

__all__ = ["has_stdout_file", "is_pipe", "name_pipes", "stdin_file", "stdout_file", "write_to_stdout"]

_FILES = re.compile(r"[^\s:'\"]*lfrender-pipe-[^/\\]+[/\\](stdin|stdout)\.\w+")
# Where the context of a command keeps the file of stdin, and that for stdout.
_STDIN, _STDOUT = "lfcal.stdin", "lfcal.stdout"


def is_pipe(text: str) -> bool:
    """Whether a word stands for a pipe: `-`, or for outputs `-` and the suffix of a format, as `-.tif`."""
    return text == "-" or text.startswith("-.")


def stdin_file(ctx: click.Context) -> Path:
    """A file with what comes from stdin; its suffix tells the format of an image by the first bytes."""
    root = ctx.find_root()
    if _STDIN not in root.meta:
        data = b"" if sys.stdin.isatty() else sys.stdin.buffer.read()
        if not data:
            raise click.UsageError("- reads the input from a pipe, but nothing came: lfrender render - -o - < flat.png")
        kind = identify_format(data[:16])
        suffix = IMAGE_FORMATS[kind].suffixes[0] if kind else ".json" if data.lstrip()[:1] == b"{" else ".xml"
        root.meta[_STDIN] = _folder(root) / f"stdin{suffix}"
        root.meta[_STDIN].write_bytes(data)
    path: Path = root.meta[_STDIN]
    return path


def stdout_file(ctx: click.Context, suffix: str) -> Path:
    """A file to write, whose content `write_to_stdout` passes on."""
    root = ctx.find_root()
    if _STDOUT in root.meta:
        raise click.UsageError("only one output can go to stdout")
    path = root.meta[_STDOUT] = _folder(root) / f"stdout{suffix}"
    return path


def has_stdout_file(ctx: click.Context | None) -> bool:
    """Whether an output goes to stdout, where nothing else may be printed then."""
    return ctx is not None and _STDOUT in ctx.find_root().meta


def name_pipes(text: str) -> str:
    """A text in which the files that stand for pipes are called `stdin` and `stdout`."""
    return _FILES.sub(r"\1", text)


def write_to_stdout(ctx: click.Context) -> None:
    """Pass on the file for stdout, if a command has written one."""
    path = ctx.find_root().meta.get(_STDOUT)
    if path is None or not path.is_file():
        return
    sys.stdout.flush()
    with open(path, "rb") as file:
        shutil.copyfileobj(file, sys.stdout.buffer)
    sys.stdout.buffer.flush()


def _folder(root: click.Context) -> Path:
    """A folder that is removed when the command has ended."""
    if "lfcal.pipes" not in root.meta:
        root.meta["lfcal.pipes"] = Path(root.with_resource(tempfile.TemporaryDirectory(prefix="lfrender-pipe-")))
    folder: Path = root.meta["lfcal.pipes"]
    return folder
