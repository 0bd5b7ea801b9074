"""Sequences of frames of one camera, rendered into pictures or a film, here or on a cluster.

Depth and pictures are updated incrementally where frames differ; interrupted runs are continued.
"""
