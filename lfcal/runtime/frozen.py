"""Objects whose arrays cannot be written to, not even where they come out of a pickle or a copy."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

__all__ = ["Frozen"]


class Frozen:
    """Base of frozen dataclasses whose constructor makes their arrays read-only: pickles and copies call it again.

    Kernels are compiled anew for arrays that can be written to: worker processes would have their own, which may add
    up numbers in another order.
    """

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        return type(self), tuple(getattr(self, field.name) for field in fields(self))  # type: ignore[arg-type]
