"""The words that arguments of functions, and options of the commands, choose from."""

from __future__ import annotations

from typing import Any, Literal, get_args

__all__ = ["Detail", "PoseFormat", "Preset", "Shortcut", "Tone", "check_choice"]

#: How the detail of a picture is restored.
Detail = Literal["natural", "off"]
#: Programs that views are written for with their cameras.
PoseFormat = Literal["nerfstudio", "colmap", "rvs"]
#: How much time a depth analysis takes.
Preset = Literal["fast", "balanced"]
#: What a depth analysis may leave out (`lfrender.depth.presets.Shortcuts`).
Shortcut = Literal["blank", "ranges", "still", "steady"]
#: Values in proportion to light, or encoded for a display; or as format and flat suggest.
Tone = Literal["auto", "linear", "srgb"]


def check_choice(value: Any, choices: Any, name: str) -> None:
    """Raise a ValueError with the choices (a `Literal`) if an argument is none of them."""
    if value not in get_args(choices):
        raise ValueError(f"{name} must be one of {', '.join(get_args(choices))}, got {value!r}")
