"""Recognises flats that show one plane and fits it: three numbers for all lenses, checked on every lens.

Takes a flat with its texture; `plane_depth` makes a depth map of the result.
"""
