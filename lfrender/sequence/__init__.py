"""Sequences of frames of one camera: pictures of all frames, or a film, on this machine or on a
Dask cluster.

Depth and pictures are updated incrementally where frames differ; interrupted runs are continued.
"""
