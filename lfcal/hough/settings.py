"""Tuned values of the Hough vote."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["DEFAULT", "HoughSettings"]


@dataclass(frozen=True)
class HoughSettings:
    """Tuned values of `circle_vote`; set by hand where no source is given."""

    pitches: float = 30.0  # side of the part of the flat that is searched, in pitches
    pitch: float = 24.0  # [px] pitch to which it is scaled: edges are then a few pixels wide
    level_window: float = 3.0  # [pitch] within which light is levelled
    least_distance: float = 0.7  # [pitch] between circles
    least_radius: float = 0.36  # [pitch] of circles
    most_radius: float = 0.52
    edge: float = 120.0  # upper threshold of edges on the levelled part in 8 bits (`cv2.HoughCircles`)
    votes: float = 6.0  # least number of votes of a circle
    near: float = 0.15  # [pitch] distance from a lattice point at which a circle agrees with it: 8 % do by chance
    fewest: int = 20  # circles that say something
    bin: float = 0.06  # [pitch] of the histogram of steps from circle to circle
    shortest: float = 0.7  # [pitch] steps to neighbours
    longest: float = 1.4
    peak: float = 3.0  # times the mean of the histogram that a step is more frequent
    independent: float = 0.4  # sine of the angle between the two steps of a basis, at least


DEFAULT = HoughSettings()
