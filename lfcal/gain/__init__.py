"""Relative illumination of a camera: the gain of every pixel of its flats, computed from a compact
model.

`illumination` fits the model to a flat; camera files store it. It serves flattening, rendering and
usable radii.
"""
