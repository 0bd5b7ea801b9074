"""Writing files atomically: an output appears whole or not at all."""

from __future__ import annotations

import os
import re
import secrets
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from .errors import LightFieldError, check_path
from .file_lock import file_lock
from .types import AnyPath

__all__ = [
    "OutputError",
    "atomic_write",
    "check_folder",
    "check_output",
    "claim",
    "discard_unfinished",
    "make_folder",
    "output_errors",
    "refuse_inputs",
    "refuse_leftovers",
]

# Temporary files that are being written, and locks.
_UNFINISHED: set[Path] = set()
# Outputs that this thread has claimed.
_CLAIMED: ContextVar[frozenset[Path]] = ContextVar("claimed", default=frozenset())


class OutputError(LightFieldError, OSError):
    """A result cannot be written where or how it was asked for.

    Examples
    --------
    >>> check_output("picture.gif", {".png"})
    Traceback (most recent call last):
    lfcal.runtime.output_file.OutputError: picture.gif: unknown output format '.gif'; use .png
    """


@contextmanager
def atomic_write(path: AnyPath) -> Iterator[Path]:
    """Give a temporary file beside `path`, and rename it to `path` if there is no error.

    It has the suffix of `path`, for writers that choose the format by it, and the usual permissions
    of new files. OutputError if the file cannot be made, written or moved.
    """
    with _temporary(check_path(path)) as temporary:
        yield temporary
        os.replace(temporary, path)


@contextmanager
def _temporary(target: Path) -> Iterator[Path]:
    """An empty file beside another, which is removed in the end, if it is still there."""
    temporary = target.with_name(f".{target.stem}.{secrets.token_hex(4)}{target.suffix}")
    _UNFINISHED.add(temporary)
    try:
        with output_errors(target):
            temporary.open("xb").close()
            yield temporary
    finally:
        # A missing or read-only folder is reported above.
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        _UNFINISHED.discard(temporary)


@contextmanager
def output_errors(target: AnyPath, what: str = "cannot be written") -> Iterator[None]:
    """Turn an OSError into an OutputError: the output cannot be written or made."""
    try:
        yield
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(f"{target}: {what} ({error.strerror or error})") from error


@contextmanager
def claim(output: AnyPath) -> Iterator[None]:
    """Keep other processes and threads from an output that is written in many steps.

    A function may claim what its caller has claimed. OutputError that names the other process.
    """
    target = Path(output).absolute()
    claimed = _CLAIMED.get()
    if target in claimed:
        yield
        return
    lock = target.with_name(f".{target.name}.lock")
    with ExitStack() as stack:
        with output_errors(output):
            try:
                stack.enter_context(file_lock(lock))
            except BlockingIOError as error:
                raise OutputError(
                    f"{output}: is being written by {error}; wait for its end, or give another "
                    "output"
                ) from error
        _UNFINISHED.add(lock)
        stack.callback(_UNFINISHED.discard, lock)
        stack.callback(_CLAIMED.reset, _CLAIMED.set(claimed | {target}))
        yield


def discard_unfinished() -> None:
    """Remove the temporary files of this process, which ends without finishing them."""
    for temporary in list(_UNFINISHED):
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def check_output(
    path: AnyPath,
    suffixes: Collection[str],
    inputs: Iterable[AnyPath | None] = (),
) -> None:
    """Refuse an output that cannot be written, before anything is computed for it.

    OutputError if its ending is none of the `suffixes` (lower case), if it is a folder or one of
    the `inputs`, or if no file can be made beside it.
    """
    target = Path(path)
    if target.suffix.lower() not in suffixes:
        raise OutputError(
            f"{target}: unknown output format '{target.suffix}'; use {', '.join(sorted(suffixes))}"
        )
    if target.is_dir():
        raise OutputError(f"{target}: is a folder; give a file name")
    refuse_inputs(target, inputs)
    _check_place(target)


def refuse_inputs(path: AnyPath, inputs: Iterable[AnyPath | None]) -> None:
    """Raise an OutputError if an output is one of the files that are read for it."""
    target = Path(path)
    if target.exists() and any(
        source and Path(source).exists() and target.samefile(source) for source in inputs
    ):
        raise OutputError(f"{target}: is an input of this command; give another output")


def _check_place(target: Path) -> None:
    """Raise an OutputError if no file can be made beside another."""
    if not target.parent.is_dir():
        raise OutputError(f"{target}: the folder '{target.parent}' does not exist")
    with _temporary(target):
        pass


def check_folder(path: AnyPath, parents: bool = False) -> Path:
    """Refuse a folder for results that cannot be written, before anything is computed for it.

    OutputError if it is a file, or is named like one and does not exist yet, or if no file can be
    made in it. With `parents`, folders above it need not exist.
    """
    target = Path(path)
    if target.exists() and not target.is_dir():
        raise OutputError(f"{target}: is a file; give a folder")
    if not target.exists() and re.fullmatch(r"\.[A-Za-z]\w{1,5}", target.suffix):
        problem = (
            f"unknown output format '{target.suffix}'; for a folder leave out the ending, or "
            "make it first"
        )
        raise OutputError(f"{target}: {problem}")
    place = target
    if target.exists():
        place = target / "result"
    while parents and not place.parent.exists():
        place = place.parent
    _check_place(place)
    return target


def refuse_leftovers(folder: Path, pattern: str, names: Collection[str]) -> None:
    """Refuse a folder that holds files of an earlier run which this run does not replace.

    Both together would look like one result.

    `pattern` is a regular expression of the names that such results have, `names` are the new
    files. OutputError if other files match; nothing is removed.
    """
    if not folder.is_dir():
        return
    found = (path.name for path in folder.iterdir() if re.fullmatch(pattern, path.name))
    left = sorted(name for name in found if name not in names)
    if left:
        problem = (
            f"holds {left[0]} of an earlier run, {len(left)} files that this run does not replace"
        )
        raise OutputError(f"{folder}: {problem}; delete them, or give another folder")


def make_folder(path: AnyPath, parents: bool = False) -> Path:
    """Make a folder for results where it does not exist, as `check_folder` allows.

    OutputError if that fails.
    """
    target = check_folder(path, parents)
    with output_errors(target, "cannot be made"):
        target.mkdir(parents=parents, exist_ok=True)
    return target
