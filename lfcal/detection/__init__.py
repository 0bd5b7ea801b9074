"""Detection: the first lattice of a flat, from its spectrum and average microimages, and what kind
of flat it is.

From a raw picture alone, for the final fits of `scene_fit` and `white_fit`; other repeating
patterns are refused.
"""
