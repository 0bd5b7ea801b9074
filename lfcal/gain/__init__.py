"""Relative illumination: the gain of every pixel, computed from a compact model.

`illumination` fits the model to a flat; camera files store it. It serves flattening, rendering and
usable radii.
"""
