"""What a command tells while it runs and at its end: stages, closing sentences, figures as text or as JSON."""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any

import click

from ..errors import LightFieldError
from .pipes import has_stdout_file, name_pipes
from .terminal import Terminal

__all__ = ["Report", "name_file_in_errors", "report_options"]

# Where the context of a command keeps whether `--verbose` was given.
_VERBOSE = "lfcal.verbose"


class Report:
    """Progress and figures of one command.

    Parameters
    ----------
    as_json : bool
        Print the figures as one JSON object on stdout instead of as text.
    quiet : bool
        Print nothing but warnings; with `as_json`, nothing but the JSON object.
    log_stages : bool
        Print a line for each stage where there is no terminal, for long commands.
    """

    def __init__(self, as_json: bool = False, quiet: bool = False, log_stages: bool = False) -> None:
        self.as_json = as_json
        self.quiet = quiet
        self.log_stages = log_stages
        self.seconds: dict[str, float] = {}
        #: Of compiling kernels, for the first command of an installation.
        self.compile_seconds = 0.0
        self._compiled = False
        self.warnings: list[str] = []
        self._stage = ""
        self._terminal = None if quiet or not sys.stderr.isatty() else Terminal()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage, and show it on a terminal while it runs."""
        self.compile_kernels()
        start = time.perf_counter()
        self._stage = name
        with ExitStack() as shown:
            if self._terminal is not None:
                shown.enter_context(self._terminal.stage(name))
            elif self.log_stages and not (self.quiet or self.as_json):
                click.echo(f"{name} ...", err=_is_piped())
            yield
        self.seconds[name] = time.perf_counter() - start
        if _is_verbose():
            click.echo(f"{name}: {self.seconds[name]:.3f} s", err=True)

    @contextmanager
    def progress(self, name: str, total: int | None, before: int = 0) -> Iterator[Callable[[str], None]]:
        """Gives a function to call after each of `total` steps, of which some were done `before`, with a remark or "".

        On a terminal a bar shows rate and remaining time; else remarks are printed on stderr.
        """
        if self._terminal is None:
            yield lambda remark: click.echo(remark, err=True) if remark and not self.quiet else None
            return
        shown = name if self._stage in ("", name) else f"{self._stage}, {name}"
        with self._terminal.bar(shown, total, before) as advance:
            yield advance

    @contextmanager
    def counted_progress(self, name: str) -> Iterator[Callable[[int, int], None]]:
        """Gives a function to call with the numbers of finished and of all steps, known from the first call on."""
        with ExitStack() as shown:
            advance: list[Callable[[str], None]] = []

            def step(done: int, count: int) -> None:
                if not advance:
                    advance.append(shown.enter_context(self.progress(name, count, done - 1)))
                advance[0]("")

            yield step

    def compile_kernels(self, processes: int | None = None) -> int | None:
        """Compile all kernels, if that has not been done for this installation; returns how many could not be.

        None where nothing was to be done. The seconds of this are not in `took`.
        """
        from ..compile_ahead import compile_once, is_compiled

        if self._compiled or is_compiled():
            return None
        self._compiled = True
        if not self.quiet and (not self.as_json or sys.stderr.isatty()):
            text = "compiling kernels, once per installation: a minute or two on two cores, more on a busy machine ..."
            click.echo(text, err=self.as_json or _is_piped())
        start = time.perf_counter()
        with self.counted_progress("compiling kernels") as step:
            failed = compile_once(processes, step)
        self.compile_seconds = time.perf_counter() - start
        return failed

    def warn(self, text: str) -> None:
        """Add a warning to those that are printed at the end."""
        self.warnings.append(text)

    @property
    def took(self) -> str:
        """The seconds of all stages so far, for a closing sentence."""
        seconds = sum(self.seconds.values())
        return f"{seconds:.2f} s" if seconds < 1 else f"{seconds:.1f} s" if seconds < 100 else f"{seconds / 60:.1f} min"

    def finish(self, figures: Mapping[str, Any], *sentences: str) -> None:
        """Print the warnings among the figures on stderr, and sentences that sum the figures up.

        With `as_json`, print all figures with the seconds of all stages; without any sentence, print them as a table.
        Where an output goes to stdout, all of it is printed on stderr.
        """
        if self.warnings:
            figures = {**figures, "warnings": [*figures.get("warnings", ()), *self.warnings]}
        figures = {**figures, "seconds": {name: round(value, 4) for name, value in self.seconds.items()}}
        if self.as_json:
            click.echo(name_pipes(json.dumps(_to_json_types(figures))), err=_is_piped())
            return
        for warning in figures.get("warnings", ()):
            click.echo(name_pipes(f"warning: {warning}"), err=True)
        if self.quiet:
            return
        for sentence in sentences:
            click.echo(name_pipes(sentence), err=_is_piped())
        if not sentences:
            rows = _rows({name: value for name, value in figures.items() if name != "warnings"})
            width = max(map(len, rows)) + 2
            for name, value in rows.items():
                click.echo(f"{name.replace('_', ' '):{width}}{name_pipes(value)}", err=_is_piped())


@contextmanager
def name_file_in_errors(path: str | os.PathLike[str]) -> Iterator[None]:
    """Put the name of a file before errors that do not have it."""
    try:
        yield
    except LightFieldError as error:
        if str(path) in str(error):
            raise
        raise type(error)(f"{path}: {error}") from error


def report_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the options `--json`, `--quiet` and `--verbose`."""
    verbose = click.option(
        "--verbose",
        is_flag=True,
        expose_value=False,
        callback=_store_verbose,
        help="Print each stage on stderr, with its seconds, as soon as it has ended.",
    )
    command = verbose(command)
    command = click.option("--quiet", is_flag=True, help="Print nothing but warnings.")(command)
    return click.option("--json", "as_json", is_flag=True, help="Print the figures as one JSON object.")(command)


def _store_verbose(context: click.Context, _option: click.Parameter, value: bool) -> None:
    context.meta[_VERBOSE] = value


def _is_piped() -> bool:
    return has_stdout_file(click.get_current_context(silent=True))


def _is_verbose() -> bool:
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(_VERBOSE))


def _to_json_types(value: Any) -> Any:
    """`value` in types of JSON: NumPy to Python, NaN and infinity to null."""
    if isinstance(value, Mapping):
        return {str(key): _to_json_types(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_to_json_types(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, os.PathLike) else value


def _rows(figures: Mapping[str, Any]) -> dict[str, str]:
    """Name and text of each figure; a mapping of mappings becomes one row for each of them."""
    rows = {}
    for name, value in figures.items():
        if isinstance(value, Mapping) and any(isinstance(item, Mapping) for item in value.values()):
            rows.update({f"{name}, {inner}": _text(item) for inner, item in value.items()})
        else:
            rows[name] = _text(value)
    return rows


def _text(value: Any) -> str:
    value = _to_json_types(value)
    if isinstance(value, dict):
        return ", ".join(f"{key.replace('_', ' ')} {_text(item)}" for key, item in value.items())
    if isinstance(value, list):
        return "  ".join(_text(item) for item in value)
    if value is None:
        return "unknown"
    return f"{value:.5g}" if isinstance(value, float) else str(value)
