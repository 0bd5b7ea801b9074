"""Tuned values of `edges`, chosen on s3_r5, simulated houses of 17 and 21 px and clutter of 22 px, among others."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["DEFAULT", "EdgeSettings"]


@dataclass(frozen=True)
class EdgeSettings:
    """Tuned values of `locate_edges`."""

    reach: float = 1.0  # [pitch] a pixel may show a depth that the surface has so near to the place it would be at
    least_jump: float = 0.1  # [pitch] edges between patch sizes that differ by less are left alone
    shown: float = 2.0  # lenses that show a place in the mean, its own among them: with fewer nothing is changed
    views: int = 5  # other lenses that a pixel is compared with, at most; 10 gain 0.1 dB
    agreeing: int = 100  # lenses on one surface with their neighbours that show how well these agree, at most
    noise: float = 3.0  # of their median difference where contrast is low; what differs by less is no mismatch
    seen: float = 0.5  # of what is no mismatch: deviation of a patch on an edge that is seen; plain patches have 0.2
    moved: float = 0.02  # share of the pixels of a lens that leave the surface, from which it is looked at again
    contrast_share: float = 2.0  # of the variance of a patch by which patches may differ: blur and resampling
    visible_share: float = 0.6  # first round: share of the views that must show a depth, since some are occluded
    unseen: float = 0.5  # mismatch of a pixel that no other lens shows; set by hand
    leave: float = 0.03  # price of another depth than that of the surface, in units of the mismatch
    jump: float = 0.3  # price of a depth edge between pixels of one brightness, in units of the mismatch
    edge_contrast: float = 0.06  # [white] difference of brightness at which that price has fallen by 63 %
    finer: int = 2  # the grid of the surface becomes so many times as fine: outlines to half of 1/7 pitch
    voters: int = 9  # lenses nearest to a scene point, whose pixels vote for its depth; 5 lose up to 0.1 dB
    speck: int = 5  # [points of the finer grid] width of the median that removes single wrong points


DEFAULT = EdgeSettings()
