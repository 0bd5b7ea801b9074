"""Progress, warnings and figures of one command, on terminals, in pipes and as JSON."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import click
import msgspec

from ..errors import LightFieldError
from ..progress import ProgressDisplay
from ..types import AnyPath
from .parameters import is_piped, name_pipes

__all__ = ["Report", "echo", "echo_json", "name_file_in_errors"]

# Control characters except line ends, and characters that turn the direction of writing.
_CONTROL = "[\x00-\x09\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]"


def echo(text: object, err: bool = False) -> None:
    """Print a line; control characters of file names and texts are shown as codes.

    Files that stand for pipes are called `stdin` and `stdout`.
    """
    shown = re.sub(
        _CONTROL, lambda match: match[0].encode("unicode_escape").decode(), name_pipes(str(text))
    )
    click.echo(shown, err=err)


class Report:
    """Progress and figures of one command, as `--json`, `--quiet` and `--verbose` ask for."""

    def __init__(
        self,
        as_json: bool = False,
        quiet: bool = False,
        verbose: bool = False,
        result: Callable[..., Any] = dict,
    ) -> None:
        #: Class of the object that `--json` prints.
        self.result = result
        self.as_json = as_json
        self.quiet = quiet
        self.verbose = verbose
        self.seconds: dict[str, float] = {}
        #: Of compiling kernels, in the first command of an installation.
        self.compile_seconds = 0.0
        self.warnings: list[str] = []
        # Of the camera file, which the command that made it has told: the file, and the texts.
        self._camera: tuple[AnyPath, Collection[str]] = ("", ())
        self._display = ProgressDisplay(quiet)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage, and show it on a terminal while it runs."""
        self.compile_kernels()
        start = time.perf_counter()
        with self.progress(name):
            yield
        seconds = time.perf_counter() - start
        self.seconds[name] = self.seconds.get(name, 0.0) + seconds
        if self.verbose:
            click.echo(f"{name}: {seconds:.3f} s", err=True)

    @contextmanager
    def progress(self, name: str) -> Iterator[Callable[..., None]]:
        """Give a function to call with finished steps, all steps (None: unknown), a remark."""
        with self._display.bar(name) as step:

            def step_with_remark(done: int, count: int | None, remark: str = "") -> None:
                if remark and not self.quiet:
                    echo(remark, err=True)
                step(done, count)

            yield step_with_remark

    def compile_kernels(self, processes: int | None = None) -> int | None:
        """Compile all kernels unless this installation has done so.

        Returns the number of kernels that could not be compiled, or None if all were compiled
        before.
        """
        from ..compilation.compile_ahead import compile_once, is_compiled

        if self.compile_seconds or is_compiled():
            return None
        if not self.quiet:
            about = "once per installation: a minute or two on two cores, more on a busy machine"
            self._echo(f"compiling kernels, {about} ...")
        start = time.perf_counter()
        with self._display.bar("compiling kernels") as step:
            failed = compile_once(processes, step)
        self.compile_seconds = time.perf_counter() - start
        return failed

    def camera_warnings(self, path: AnyPath, warnings: Collection[str]) -> None:
        """Warnings that a camera file holds: their beginnings are printed, in one line."""
        self._camera = (path, warnings)

    def warn(self, text: str) -> None:
        """Add a warning to those that are printed at the end."""
        self.warnings.append(text)

    @property
    def took(self) -> str:
        """The seconds of all stages so far, and of compiling kernels before."""
        seconds = sum(self.seconds.values())
        text = f"{seconds / 60:.1f} min"
        if seconds < 100:
            text = f"{seconds:.{1 + (seconds < 1)}f} s"
        if self.compile_seconds >= 1:
            text += f" (after {self.compile_seconds:.0f} s of compiling, once)"
        return text

    def finish(self, figures: Mapping[str, Any], *sentences: str) -> None:
        """Print the warnings among the figures on stderr, and sentences that sum the figures up.

        With `--json`, print all figures, which are the fields of `result`, with the seconds of all
        stages.
        """
        found = {**figures, "warnings": [*figures.get("warnings", ()), *self.warnings]}
        if self.as_json:
            seconds = {name: round(value, 4) for name, value in self.seconds.items()}
            echo_json(self.result(**found, seconds=seconds))
            return
        for warning in self._shorten(found["warnings"]):
            echo(f"warning: {warning}", err=True)
        for line in () if self.quiet else sentences:
            self._echo(line)

    def _shorten(self, warnings: list[str]) -> list[str]:
        """The warnings, with those of the camera file in one line, if that is shorter."""
        path, stored = self._camera
        known = [text for text in warnings if text in stored]
        heads = "; ".join(re.split(r"[,;:(]", text)[0].strip() for text in known)
        line = f"{path}: {heads} ('lfcal info {path}' says more)"
        if len(line) >= len("".join(known)):
            return warnings
        return [line, *(text for text in warnings if text not in stored)]

    def _echo(self, line: str) -> None:
        echo(line, err=self.as_json or is_piped())


@contextmanager
def name_file_in_errors(path: AnyPath) -> Iterator[None]:
    """Put the name of a file before errors that do not have it."""
    try:
        yield
    except LightFieldError as error:
        if str(path) in str(error):
            raise
        raise type(error)(f"{path}: {error}") from error


def echo_json(value: Any) -> None:
    """Print an object of results as one line of JSON, on stderr if an output goes to stdout."""
    # NaN and infinity are null.
    text = msgspec.json.encode(value, enc_hook=_built_in).decode()
    # JSON escapes control characters below space, but not these.
    text = re.sub("[\x7f-\x9f]", lambda match: f"\\u{ord(match[0]):04x}", text)
    echo(text, err=is_piped())


def _built_in(value: Any) -> Any:
    if isinstance(value, os.PathLike):
        return str(value)
    return value.tolist()
