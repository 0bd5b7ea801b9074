"""Tuned values of `edges`, chosen on s3_r5, simulated houses of 17 and 21 px and clutter of 22 px, among others."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["DEFAULT", "EdgeSettings"]


@dataclass(frozen=True)
class EdgeSettings:
    """Tuned values of `locate_edges`."""

    reach: float = 2.0  # [pitch] a pixel may show a depth that the surface has so near to the place it would be at
    noise: float = 0.02  # [white] difference of two pixels that is no mismatch, at least
    contrast_share: float = 2.0  # of the variance of a patch by which patches may differ: blur and resampling
    unseen_cost: float = 0.6  # mismatch of a pixel that no other lens shows; set by hand
    settled: int = 2  # [px] a pixel with one surface so far around it in the first round is not looked at again
    visible_share: float = 0.6  # first round: share of the views that must show a depth, since some are occluded
    jump: float = 0.3  # price of a depth edge between pixels of one colour, in units of the mismatch
    edge_colour: float = 0.1  # [white] difference of colour at which that price has fallen by 63 %
    finer: int = 2  # the grid of the surface becomes so many times as fine: outlines to half of 1/7 pitch
    voters: int = 9  # lenses nearest to a scene point, whose pixels vote for its depth; 5 lose up to 0.1 dB
    speck: int = 5  # [points of the finer grid] width of the median that removes single wrong points


DEFAULT = EdgeSettings()
