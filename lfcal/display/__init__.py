"""How well a calibration fits: against the pixels of a flat, against another calibration, and as a
picture.
"""
