"""Measure the illumination of a camera on one flat: gain map, vignetting, defects.

Works on the flat and its fitted lattice; `calibrate` stores the result in the calibration.
"""
