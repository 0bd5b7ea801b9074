"""Tuned values of tiles: how large they are, what surrounds them, and how many are worked on at once."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["DEFAULT", "LargeSettings"]


@dataclass(frozen=True)
class LargeSettings:
    """Tuned values of `analyze_large` and `render_large`."""

    # Analysis by tiles of lenses.
    halo: float = 8.0  # [pitch] of lenses analysed around a tile; shading is averaged over 4.2, the rest is for support
    analysis_memory: float = 6e8  # [bytes] of a tile; set by hand
    bytes_per_pixel: int = 20  # of a tile as it is analysed: grey, without shading, cut out, masks; counted
    copies_read: int = 2  # of the pixels as read: those of this tile and of the next one
    alignment_cells: int = 40  # of the surface's grid, among which one begins where a block of pixels does; set by hand

    # Windows, from which noise and range of depths of the whole flat are estimated.
    windows: int = 6  # along each axis; set by hand
    window_pitches: float = 16.0  # [pitch] side of a window ...
    window_pixels: int = 256  # [px] ... and at least this; set by hand
    window_margin: float = 3.0  # [pitch] lenses this near to the border of a window are not used; set by hand

    # Rendering by tiles of the picture.
    picture_memory: int = 1 << 30  # [bytes] of the flat and the picture of a tile, all copies together; set by hand
    tiles_per_thread: int = 4  # of a cluster, so that few threads are idle at the end
    least_tile: int = 512  # [px] smaller tiles for a cluster would be mostly halo
    sync_seconds: float = 2.0  # [s] between two times at which finished tiles are made safe on the disk

    # Cluster.
    tiles_ahead: int = 2  # tiles in flight for each thread: one that is worked on, and one that waits
    retries: int = 3  # of a tile whose worker was lost


#: The values that are used unless others are given.
DEFAULT = LargeSettings()
