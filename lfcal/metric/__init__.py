"""Metric calibration: optics of a camera and their covariance, from flats of a board."""
