"""Progress on a terminal: the stage with its seconds, and a bar with rate and remaining time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["Terminal"]


class Terminal:
    """The last lines of the terminal: one for each stage and each bar that runs."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        columns = SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
        console = Console(stderr=True)
        self._progress = Progress(*columns, TextColumn("{task.fields[rate]}"), console=console, transient=True)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Show a stage and its seconds so far."""
        with self._line(name, None, 0):
            yield

    @contextmanager
    def bar(self, name: str, total: int | None, before: int = 0) -> Iterator[Callable[[str], None]]:
        """Show steps out of `total`, of which some were done `before`; see `Report.progress`."""
        start, done = time.perf_counter(), 0
        with self._line(name, total, before) as task:

            def advance(remark: str) -> None:
                nonlocal done
                if remark:
                    self._progress.console.print(remark, markup=False, highlight=False)
                done += 1
                rate = done / (time.perf_counter() - start)
                left = "" if total is None else f", {(total - before - done) / rate:.0f} s left"
                steps = f"{before + done}/{total or '?'}, {rate:.2f} a second{left}"
                self._progress.update(task, advance=1, rate=steps)

            yield advance

    @contextmanager
    def _line(self, name: str, total: int | None, completed: int) -> Iterator[Any]:
        self._progress.start()
        task = self._progress.add_task(name, total=total, completed=completed, rate="")
        try:
            yield task
        finally:
            self._progress.remove_task(task)
            if not self._progress.tasks:
                self._progress.stop()
