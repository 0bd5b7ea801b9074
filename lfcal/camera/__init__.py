"""The result of a calibration: lattice, gain, lens types, optics and uncertainties of a camera."""
