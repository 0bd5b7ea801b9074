"""Animations and films of views and of focus, whose form is decided by the suffix of the output."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..data.rendering import Rendering

__all__ = ["MOVING_SUFFIXES", "PICTURES", "check_moving", "write_moving"]

#: Suffixes of files that hold nothing but moving pictures.
MOVING_SUFFIXES = frozenset({".gif", ".mp4", ".mkv"})
#: How many pictures an animation has where none are asked for: two seconds.
PICTURES = 24


def check_moving(path: Path, dtype: Any = None, inputs: Iterable[Any] = ()) -> None:
    """Raise an error if an animation or a film could not be written, before it is drawn."""
    if _is_film(path):
        from .film import check_film

        check_film(path, inputs)
    else:
        from ..output.views import check_animation

        check_animation(path, dtype, inputs)


def write_moving(path: Path, pictures: Iterable[Rendering]) -> None:
    """Write pictures as an animation or a film; the file appears whole or not at all."""
    if _is_film(path):
        from .film import write_film

        write_film(path, pictures)
    else:
        from ..output.views import write_animation

        write_animation(path, pictures)


def _is_film(path: Path) -> bool:
    return path.suffix.lower() in (".mp4", ".mkv")
