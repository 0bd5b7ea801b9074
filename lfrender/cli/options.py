"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from lfcal.runtime import console

__all__ = [
    "CAMERA", "INPUT", "OUTPUT", "WITHOUT_CAMERA", "at_most_one", "cluster_options", "flat_argument", "preset_option",
]  # fmt: skip

INPUT, OUTPUT = console.InputPath(), click.Path(path_type=Path)
CAMERA = "Camera file of lfcal, or a published calibration (.xml, .cfg)."
WITHOUT_CAMERA = " Without it, the camera is calibrated from FLAT."

flat_argument = console.single_input("FLAT", "'lfrender batch' renders several")


def preset_option(command: Any) -> Any:
    """Give a command the option `--preset`."""
    return click.option(
        "--preset",
        type=click.Choice(["fast", "balanced", "accurate"]),
        default="balanced",
        show_default=True,
        help="How much time the depth analysis may take.",
    )(command)


def cluster_options(command: Any) -> Any:
    """Give a command the options `--workers` and `--scheduler`."""
    scheduler = click.option("--scheduler", metavar="tcp://HOST:PORT", help="Work on tiles on this Dask scheduler.")
    workers = click.option("--workers", type=click.IntRange(1), help="Work on tiles in so many processes (needs Dask).")
    return workers(scheduler(command))


def at_most_one(*pairs: Any) -> None:
    """Refuse options that exclude each other: names and values in turn, None for those not given."""
    given = [name for name, value in zip(pairs[::2], pairs[1::2], strict=True) if value is not None]
    if len(given) > 1:
        raise click.UsageError(f"{given[0]} and {given[1]} exclude each other")
