"""What the analysis of the next frame needs of a depth map beside its fields."""

from __future__ import annotations

import weakref
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["FrameState", "LocalMatch"]


@dataclass(frozen=True)
class LocalMatch:
    """How lenses match at and about the depth they had.

    Parameters
    ----------
    cost : (n,) float32
        At that depth.
    offset : (n,) float32 [px of the search]
        From there to the minimum.
    error : (n,) float32 [px of the search]
        Standard error of the offset for one pair.
    clear, textured : (n,) bool
        Lenses with texture, and with any that a match may distinguish from noise.
    """

    cost: NDArray[np.float32]
    offset: NDArray[np.float32]
    error: NDArray[np.float32]
    clear: NDArray[np.bool_]
    textured: NDArray[np.bool_]

    def where(self, mask: NDArray[np.bool_], other: LocalMatch) -> LocalMatch:
        """This one, with the lenses of `mask` (n,) taken from another."""
        return LocalMatch(*(np.where(mask, getattr(other, f.name), getattr(self, f.name)) for f in fields(self)))


@dataclass
class FrameState:
    """State of a depth map in a sequence: neither saved with it nor compared.

    Parameters
    ----------
    reference : LocalMatch, optional
        What the `kept` lenses are compared with: their match in the frame in which their depth was estimated. A
        comparison with the last frame only would let many small changes pass.
    kept : (n,) bool, optional
        Lenses that have kept their depth from an earlier frame.
    complete : LocalMatch, optional
        The reference of all lenses; made when the first next frame needs it.
    changed : (n,) bool, optional
        Lenses that show something else than in the frame of `previous`.
    previous : weakref of DepthMap, optional
    """

    reference: LocalMatch | None = None
    kept: NDArray[np.bool_] | None = None
    complete: LocalMatch | None = None
    changed: NDArray[np.bool_] | None = None
    previous: weakref.ref[Any] | None = None

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        """Pickles hold what cannot be made again from the frame."""
        return FrameState, (self.reference, self.kept)
