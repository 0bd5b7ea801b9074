"""Sub-pixel patch sizes of lenses, with standard errors, from the pixels of all pairs of
neighbouring microimages.

Pairs are fitted by least squares, lenses by robust planes through their pairs, and smoothed over
each surface.
"""
