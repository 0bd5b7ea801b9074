"""What depends on a camera alone, kept as long as the camera is: frame after frame asks for the same."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Hashable
from functools import partial
from typing import Any, TypeVar

__all__ = ["remembered"]

_Value = TypeVar("_Value")

# By the identity of the owner: cameras hold arrays, and compare as those do. An entry goes with its owner.
_Kept = dict[int, tuple[weakref.ref[Any], dict[Hashable, Any]]]
_kept: _Kept = {}


def remembered(owner: Any, key: Hashable, make: Callable[[], _Value]) -> _Value:
    """What `make` returns, made once for each frozen `owner` and `key`; the owner itself is not kept alive.

    Values are shared: nobody may write into them. They must not refer to their owner, or both would stay for good.
    """
    at = id(owner)
    entry = _kept.get(at)
    if entry is None or entry[0]() is not owner:
        entry = weakref.ref(owner, partial(_forget, _kept, at)), {}
        _kept[at] = entry
    values = entry[1]
    if key not in values:
        values[key] = make()
    kept: _Value = values[key]
    return kept


def _forget(kept: _Kept, at: int, gone: weakref.ref[Any]) -> None:
    """Drop an entry; names of this module may be gone before, when the process ends."""
    entry = kept.get(at)
    if entry is not None and entry[0] is gone:
        del kept[at]
