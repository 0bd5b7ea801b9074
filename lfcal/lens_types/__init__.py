"""Lens types of multi-focus arrays: the type of each lens, and the order of the foci.

From sharpness and rims of a few thousand lenses, compared with their neighbours.
"""
