"""Dataclasses whose arrays cannot be written to, also after pickling or copying."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

__all__ = ["Frozen"]


class Frozen:
    """Base of frozen dataclasses with read-only arrays: pickles and copies call their constructor again.

    Numba compiles kernels anew for writable arrays: worker processes would have kernels of their own, which may add
    up numbers in another order.
    """

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        return type(self), tuple(getattr(self, field.name) for field in fields(self))  # type: ignore[arg-type]

    def _set(self, **values: Any) -> None:
        """Set fields in `__post_init__`, arrays as read-only ones."""
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
            object.__setattr__(self, name, value)
