"""Dataclasses of arrays that cannot be written to, also after pickling or copying, and that compare by value."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

__all__ = ["Frozen"]


class Frozen:
    """Base of frozen dataclasses with arrays: pickles and copies call their constructor again, `==` compares values.

    The dataclass is declared with `eq=False`, since tuples of arrays cannot be compared. NaN equals NaN.

    Numba compiles kernels anew for writable arrays: worker processes would have kernels of their own, which may add
    up numbers in another order.
    """

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        return type(self), tuple(getattr(self, field.name) for field in fields(self))  # type: ignore[arg-type]

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        compared = (field.name for field in fields(self) if field.compare)  # type: ignore[arg-type]
        return all(_equal(getattr(self, name), getattr(other, name)) for name in compared)

    def _set(self, **values: Any) -> None:
        """Set fields in `__post_init__`, arrays as read-only ones."""
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
            object.__setattr__(self, name, value)


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return np.array_equal(one, other, equal_nan=one.dtype.kind == "f" and other.dtype.kind == "f")
    return bool(one == other or (one != one and other != other))
