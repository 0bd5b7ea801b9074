"""Progress on a terminal: the stage with its seconds, or a bar with rate and remaining time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["Terminal"]


class Terminal:
    """The last line of the terminal, for one display at a time: a bar hides its stage while it is shown."""

    def __init__(self) -> None:
        from rich.console import Console

        self._console = Console(stderr=True)
        self._displays: list[Any] = []

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Show a stage and its seconds so far."""
        from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
        with self._shown(Progress(*columns, console=self._console, transient=True)) as display:
            display.add_task(name, total=None)
            yield

    @contextmanager
    def bar(self, name: str, total: int | None, before: int = 0) -> Iterator[Callable[[str], None]]:
        """Show steps out of `total`, of which some were done `before`; see `Report.progress`."""
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}")
        start = time.perf_counter()
        with self._shown(Progress(*columns, TimeRemainingColumn(), console=self._console, transient=True)) as display:
            task = display.add_task(name, total=total, completed=before, rate="")

            def advance(remark: str) -> None:
                if remark:
                    display.console.print(remark, markup=False, highlight=False)
                done = display.tasks[0].completed + 1 - before
                display.update(task, advance=1, rate=f"{done / (time.perf_counter() - start):.2f} a second")

            yield advance

    @contextmanager
    def _shown(self, display: Any) -> Iterator[Any]:
        """Show a display instead of the current one, which is shown again afterwards."""
        if self._displays:
            self._displays[-1].stop()
        self._displays.append(display)
        display.start()
        try:
            yield display
        finally:
            self._displays.pop().stop()
            if self._displays:
                self._displays[-1].start()
