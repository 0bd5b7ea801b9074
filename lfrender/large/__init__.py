"""Depth and pictures of flats larger than memory, tile by tile.

Tiles are computed here or on a Dask cluster. Interrupted runs are continued.

The tiles call the same functions as `lfrender.depth` and `lfrender.rendering`.
"""
