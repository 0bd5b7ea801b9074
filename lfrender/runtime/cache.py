"""What depends on a camera alone, kept as long as the camera is: frame after frame asks for the same."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

__all__ = ["cached", "cached_latest"]

_Value = TypeVar("_Value")

# By the identity of the owner, since cameras hold arrays, and compare and hash as those do. An entry goes with its
# owner.
_entries: dict[int, dict[Hashable, Any]] = {}


def cached(owner: Any, key: Hashable, make: Callable[[], _Value]) -> _Value:
    """What `make` returns, made once for each frozen `owner` and `key`; the owner itself is not kept alive.

    Values are shared: nobody may write into them. They must not refer to their owner, or both would stay for good.
    """
    at = id(owner)
    values = _entries.get(at)
    if values is None:
        values = _entries[at] = {}
        weakref.finalize(owner, _entries.pop, at, None).atexit = False
    if key not in values:
        values[key] = make()
    kept: _Value = values[key]
    return kept


def cached_latest(owner: Any, name: str, key: Hashable, make: Callable[[], _Value]) -> _Value:
    """As `cached`, but of each `name` only what was asked for last is kept."""
    last: dict[str, tuple[Hashable, _Value]] = cached(owner, name, dict)
    found = last.get(name)
    if found is None or found[0] != key:
        # Other threads may ask for something else meanwhile.
        found = last[name] = key, make()
    return found[1]
