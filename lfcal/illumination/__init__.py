"""Measure the illumination of a camera from one flat: gain map, average vignetting, usable radius
and defects.

Works on the flat and its fitted lattice; `calibrate` stores the result in the calibration.
"""
