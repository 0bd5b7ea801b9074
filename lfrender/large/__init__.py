"""Depth and pictures of flats too large for memory, tile by tile: here or on a Dask cluster,
resumable.

The tiles call the same functions as `lfrender.depth` and `lfrender.rendering`.
"""
