"""The result of a calibration: lattice, gain, lens types and uncertainties of one camera, with its
JSON form.
"""
