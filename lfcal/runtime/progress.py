"""Progress of long work: a bar on a terminal or in a notebook, lines in a log, or a function.

Bars are drawn by Rich, in notebooks with ipywidgets.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["Progress", "ProgressDisplay", "Step", "show_progress"]

#: Called with the number of finished steps and of all steps (None: unknown).
Step = Callable[[int, int | None], None]
#: What public functions take as `progress`: True shows a bar, a function is called at each step.
Progress = bool | Step | None

# Seconds between two lines about a long step where nothing is a terminal: nobody thinks it hangs.
_LINE_EVERY = 30.0


class ProgressDisplay:
    """Bars on stderr if it is a terminal or a notebook shows it, one below another."""

    def __init__(self, quiet: bool = False) -> None:
        self._quiet = quiet
        self._bars: Any = None
        if quiet or not (sys.stderr.isatty() or "ipykernel" in sys.modules):
            return
        from rich.console import Console
        from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn

        columns = *Progress.get_default_columns(), MofNCompleteColumn(), TimeElapsedColumn()
        self._bars = Progress(*columns, console=Console(stderr=True), transient=True)

    @property
    def drawn(self) -> bool:
        """Whether bars are drawn at all."""
        return self._bars is not None

    @contextmanager
    def bar(self, name: str) -> Iterator[Step]:
        """Show a bar while the work inside runs; where there is none, a line at times.

        Gives a function to call at each step.
        """
        bars = self._bars
        if bars is None:
            yield _ignore if self._quiet else _print_at_times(name)
            return
        bars.start()
        task = bars.add_task(name, total=None)
        try:
            yield lambda done, count: bars.update(task, completed=done, total=count)
        finally:
            bars.remove_task(task)
            if not bars.tasks:
                bars.stop()


@contextmanager
def show_progress(progress: Progress, name: str) -> Iterator[Step]:
    """Give the function that work calls at each step, as its argument `progress` asks for.

    With True, kernels are compiled ahead if this installation has not done so, and that is
    announced.
    """
    if callable(progress):
        yield progress
        return
    if progress not in (True, False, None):
        kind = type(progress).__name__
        raise TypeError(f"progress must be True, False or a function, got {kind}")
    if not progress:
        yield _ignore
        return
    display = ProgressDisplay()
    _compile_kernels(display)
    with display.bar(name) as step:
        yield step


def _compile_kernels(display: ProgressDisplay) -> None:
    """Compile all kernels in a process of its own, which does not run the script of the user."""
    from .compilation.compile_ahead import is_compiled

    if is_compiled():
        return
    print("compiling kernels, once per installation: a minute or more ...", file=sys.stderr)
    command = [sys.executable, "-m", "lfrender", "warm"]
    if display.drawn:
        command.append("--quiet")
    with display.bar("compiling kernels"):
        subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, check=False)


def _ignore(done: int, count: int | None) -> None:
    """Do nothing at a step."""


def _print_at_times(name: str) -> Step:
    """A function that prints a line about its steps every half a minute."""
    start = last = time.perf_counter()

    def step(done: int, count: int | None) -> None:
        nonlocal last
        now = time.perf_counter()
        if now - last >= _LINE_EVERY:
            last = now
            print(f"{name}: {done} of {count or '?'} after {now - start:.0f} s", file=sys.stderr)

    return step
