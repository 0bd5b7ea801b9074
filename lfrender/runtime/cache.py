"""Cache of values that depend on a frozen object only, such as a camera, while it exists."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

__all__ = ["cached", "cached_latest"]

_Value = TypeVar("_Value")

# By the identity of the owner, since cameras hold arrays and are not hashable. An entry is deleted
# with its owner.
_entries: dict[int, dict[Hashable, Any]] = {}


def cached(owner: Any, key: Hashable, make: Callable[[], _Value]) -> _Value:
    """The result of `make`, which is called once for each frozen `owner` and `key`.

    The cache does not keep the owner in memory. Values must not be changed, and must not refer to
    the owner, or neither would be freed.
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
    """As `cached`, but only the last `key` of each `name` is kept."""
    last: dict[str, tuple[Hashable, _Value]] = cached(owner, name, dict)
    found = last.get(name)
    if found is None or found[0] != key:
        # Another thread may replace the entry meanwhile.
        found = last[name] = key, make()
    return found[1]
