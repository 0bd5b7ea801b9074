"""Lens types of multi-focus arrays: which lens is of which type, and the order of their foci, for
`calibrate`.

From sharpness and rims of a few thousand lenses, compared with their neighbours.
"""
