"""What the analysis of the next frame needs of a depth map beside its fields."""

from __future__ import annotations

import weakref
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from lfcal.runtime.arrays import Booleans, Singles

__all__ = ["FrameState", "LocalMatch"]


class LocalMatch(NamedTuple):
    """How lenses match at and about the depth they had."""

    cost: Singles  # (n,) at that depth
    offset: Singles  # (n,) [px of the search] from there to the minimum
    error: Singles  # (n,) [px of the search] standard error of the offset for one pair
    # (n,) lenses with texture, and with any that a match may distinguish from noise
    clear: Booleans
    textured: Booleans

    def where(self, mask: Booleans, other: LocalMatch) -> LocalMatch:
        """This one, with the lenses of `mask` (n,) taken from another."""
        return LocalMatch(
            *(np.where(mask, theirs, own) for theirs, own in zip(other, self, strict=True))
        )


@dataclass
class FrameState:
    """State of a depth map in a sequence: not compared."""

    # What the `kept` lenses are compared with: their match in the frame in which their depth was
    # estimated. A comparison with the last frame only would let many small changes pass.
    reference: LocalMatch | None = None
    kept: Booleans | None = None  # (n,) lenses that have kept their depth from an earlier frame
    complete: LocalMatch | None = (
        None  # the reference of all lenses; made when the first next frame needs it
    )
    changed: Booleans | None = (
        None  # (n,) lenses that show something else than in the frame of `previous`
    )
    previous: weakref.ref[Any] | None = None  # of a DepthMap

    def __reduce__(self) -> tuple[type, tuple[Any, ...]]:
        return FrameState, (self.reference, self.kept)  # the others can be made again
