"""Tuned values of gain maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

__all__ = ["DEFAULT", "KERNEL", "GainSettings", "KernelSettings"]


@dataclass(frozen=True)
class GainSettings:
    """Tuned values of `gain_map` and `rows`."""

    halo: int = 4  # [lenses] tabulated around the flat, in which rows may begin or end; set by hand
    largest_tilt: float = 0.2  # [pitch] by which a distortion may turn a lattice step backwards; set by hand
    before_rim: float = 0.75  # [light] down to which a profile is before the middle of its rim, where light is lost
    band: int = 512  # [rows] flattened at a time, so that memory does not grow with the flat


class KernelSettings(NamedTuple):
    """Values that the kernels of gain maps are compiled with."""

    least_light: float = 0.25  # [light of the lens] below it the gain is unknown: mostly noise and stray light
    edge: float = 4.0  # [standard deviations] from the edge of the cutting disc, beyond which it is all or nothing
    edge_steps: int = 32  # per standard deviation in the table of that edge; error below 1e-4 of the light
    directions: int = 32  # in which the usable radius and the mean over directions are evaluated
    same_column: float = 1e-9  # [px] lenses nearer in x lie above each other and do not follow each other in a row
    slots: int = 2048  # of that cache: enough for a row of lenses and the next one
    slot_step: int = 701  # [slots] between lenses above each other; a prime, so that the cache fills evenly


DEFAULT = GainSettings()
KERNEL = KernelSettings()
